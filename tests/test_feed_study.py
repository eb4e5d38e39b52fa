"""[feed], [product] and [material] of a study file: what is read, and every fault told where it stands."""

from __future__ import annotations

import math

import pytest

from uqsphere.errors import StudyError
from uqsphere.feed.laws import particle_share
from uqsphere.study import load_study
from uqsphere.uq.law import Law

FEED = """
[material]
name = "limestone"

[product]
A = "55 %"
b = "0.8 t/kWh"

[feed]
sizes = { law = "rosin_rammler", d63 = "30 mm", n = 1.2, top = "71.5 mm" }
blows = 3
energy = { specific = "100 J/kg" }
"""
SERVICE = """
[sphere]
material = "limestone"
radius = "10 mm"
[rig]
kind = "none"
[service.rotor]
kind = "impact"
speed = "30 m/s"
angle = "60 deg"
target = { kind = "thick", material = "steel" }
[feed]
sizes = { law = "gaudin_schuhmann", n = 0.8, top = "60 mm" }
energy = { service = "rotor" }
"""


def load(folder, text, **files):
    for name, content in files.items():
        (folder / f"{name}.csv").write_text(content, encoding="utf-8")
    (folder / "s.toml").write_text(text, encoding="utf-8")
    return load_study(folder / "s.toml")


def faults(folder, text, **files):
    with pytest.raises(StudyError) as caught:
        load(folder, text, **files)
    return str(caught.value)


def test_a_feed_needs_no_scene_and_is_part_of_the_hash(tmp_path):
    study = load(tmp_path, FEED)
    assert study.parts == {}
    plan = study.feed
    assert (plan.feed.blows.count, plan.feed.blows.share, len(plan.feed.classes.edges)) == (3, 1.0, 15)
    assert pytest.approx(0.55) == plan.product.A
    other = load(tmp_path, FEED.replace("blows = 3", "blows = 4"))
    assert other.hash != study.hash
    assert load(tmp_path, FEED + "# a remark\n").hash == study.hash


def test_a_service_gives_its_closing_speed_and_its_partner(tmp_path):
    feed = load(tmp_path, SERVICE).feed.feed
    assert feed.blows.kind == "speed"
    assert feed.blows.energy == pytest.approx(30.0 * math.sin(math.radians(60.0)))
    means = load(tmp_path, SERVICE).services["rotor"].at_means()
    share = particle_share(means["sphere.E"], means["sphere.nu"], means["target.E"], means["target.nu"])
    assert feed.blows.share == pytest.approx(float(share))


def test_energies_can_be_laws_and_falls(tmp_path):
    spectrum = FEED.replace('"100 J/kg"', '{ dist = "lognormal", mean = "100 J/kg", cov = 0.4 }')
    assert isinstance(load(tmp_path, spectrum).feed.feed.blows.energy, Law)
    fall = load(tmp_path, FEED.replace('specific = "100 J/kg"', 'drop_height = "5 m"')).feed.feed.blows
    assert (fall.kind, fall.energy) == ("specific", pytest.approx(49.05, rel=1e-3))


def test_a_table_of_sieves_is_a_size_distribution(tmp_path):
    text = FEED.replace(
        'law = "rosin_rammler", d63 = "30 mm", n = 1.2, top = "71.5 mm"', 'law = "table", file = "f.csv"'
    )
    feed = load(tmp_path, text, f="sieve_mm,passing_percent\n63,100\n16,60\n4,20\n").feed.feed
    assert feed.classes.edges[0] == pytest.approx(0.063)
    said = faults(tmp_path, text, f="sieve_mm,passing_percent\n63,60\n16,70\n4,20\n")
    assert "f.csv:2: the passing falls" in said
    assert "stands there twice" in faults(tmp_path, text, f="sieve_mm,passing_percent\n63,60\n63,60\n")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('specific = "100 J/kg"', "specific = 100", 'such as "100 J/kg"'),
        ('specific = "100 J/kg"', 'specific = "100 J/kg", speed = "9 m/s"', "one of specific"),
        ('specific = "100 J/kg"', 'service = "rotor"', 'no service "rotor"'),
        ('d63 = "30 mm", ', "", "d63 is missing"),
        (', top = "71.5 mm"', "", "top is missing"),
        ("n = 1.2", "n = -1.2", "above 0"),
        ("blows = 3", "blows = 0", "from 1 to 1000"),
        ('name = "limestone"', 'name = "cheese"', "unknown material"),
        ("blows = 3", 'blows = 3\non = { material = "chese" }', "unknown material"),
        ("blows = 3", "blows = 3\ngoal = { at_least = 0.9 }", "broken is missing"),
        ("blows = 3", 'blows = 3\nlot = "3 mm"', "unit"),
        ('b = "0.8 t/kWh"', 'b = "0.8 t/kWh"\ncurve = { law = "beta" }', "beta takes a table"),
        ('b = "0.8 t/kWh"', 'b = "0.8 t/kWh"\ncurve = { law = "beta", table = [[2, 1], [3, 1, 1]] }', "a row is"),
        ('b = "0.8 t/kWh"', 'b = "0.8 t/kWh"\ncurve = { law = "milin", alpha = 0.8 }', "alpha belongs to"),
        ('A = "55 %"', 'A = "155 %"', "A"),
    ],
)
def test_faults_are_told_where_they_stand(tmp_path, old, new, said):
    assert old in FEED
    assert said in faults(tmp_path, FEED.replace(old, new))


def test_both_a_sphere_and_a_material_are_one_too_many(tmp_path):
    assert "leave [material] out" in faults(tmp_path, SERVICE + '[material]\nname = "limestone"\n')
    assert "table [material] is missing" in faults(tmp_path, FEED.replace("[material]\nname", "[outputs]\nx"))
