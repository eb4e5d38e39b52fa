"""Exports to DEM programs, read back: names of interfaces, values, units, and what is refused or said."""

from __future__ import annotations

import ast
import csv
import io
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from test_population import FINE, TRUTH, fed, known, scattered

from uqsphere.cli import main
from uqsphere.feed import laws
from uqsphere.feed.answers import FeedPlan, answer_feed
from uqsphere.feed.dem import NotThere, choose, draws_csv, export, spread_draws
from uqsphere.feed.fit import FitEntry, Posterior
from uqsphere.feed.product import ProductPlan

EXACT = 1e-12
#: setters of ra_particle.pyi (ansys/pyrocky 3416499) and the unit that each takes without one
PYROCKY = {
    "SetTavaresEInf": "J/kg", "SetTavaresD0": "m", "SetTavaresPhi": "-", "SetTavaresSigmaSquared": "-",
    "SetTavaresRatioEmax": "-", "SetTavaresGamma": "-", "SetTavaresA": "%", "SetTavaresB": "-",
    "SetAbt10SelectFunctionCoefficient": "kg/J", "SetAbt10ReferenceMinimumSpecificEnergy": "J/kg",
    "SetAbt10ReferenceSize": "m", "SetAbt10MaximumT10Value": "%",
}  # fmt: skip
PARTICLES = {"E": 60e9, "nu": 0.25, "density": 2700.0}


def answered(posterior, form="tavares", made_up=False, **more):
    fitted = FitEntry(law=posterior.law, size=posterior.size, ratio=4.0, tested=(0.002, 0.08), made_up=made_up)
    product = ProductPlan(form=form, A=0.55, b=0.03 if form != "jk" else 0.8 / 3600.0)
    plan = FeedPlan(feed=fed(3, **more), product=product, particles=PARTICLES)
    found = answer_feed(posterior, fitted, plan)
    header, rows = found.table()
    return found.entry, dict(zip(header, np.array(rows).T, strict=True))


def vogel_peukert(draws=60):
    rng = np.random.default_rng(3)
    columns = {"f_mat": 0.9 * np.exp(0.1 * rng.standard_normal(draws)), "threshold": np.full(draws, 0.12)}
    columns |= {"C": np.ones(draws), "phi": np.ones(draws)}
    which = np.full(draws, "vogel_peukert")
    return Posterior(
        law="vogel_peukert", size="power", ratio=math.inf, draws=columns, which=which, tested=(0.002, 0.08)
    )


class Recorder:
    """Stands in PyRocky's place: keeps what is called."""

    def __init__(self):
        self.calls = []

    def __getattr__(self, name):
        def call(*arguments):
            self.calls.append((name, *arguments))
            return self

        return call


def applied(text, draw):
    scope = {}
    exec(compile(text, "rocky_breakage.py", "exec"), scope)
    recorder = Recorder()
    scope["apply"](recorder, "rock", draw)
    return recorder.calls


def test_draws_keep_their_correlation_and_are_spread_over_the_share_broken():
    posterior = scattered(800)
    entry, table = answered(posterior, form="jk")
    draws = choose(posterior, entry, table, 20)
    rows = draws.numbers - 1
    for name in TRUTH:
        assert draws.columns[name][1:] == pytest.approx(posterior.draws[name][rows], rel=EXACT)
        assert draws.columns[name][0] == pytest.approx(np.median(posterior.draws[name][rows]), rel=EXACT)
    sorted_shares = np.sort(table["broken"])
    assert draws.columns["broken"][1:] == pytest.approx(sorted_shares[19::40], rel=EXACT)
    with pytest.raises(NotThere, match="from 1 to 800"):
        spread_draws(table["broken"], 801)


def test_the_table_of_draws_has_units_notes_and_medians_that_are_no_draw():
    entry, table = answered(scattered(100), made_up=True)
    text = draws_csv(choose(scattered(100), entry, table, 5, rig_factor=1.24))
    notes = [line for line in text.splitlines() if line.startswith("#")]
    assert "MADE UP" in notes[0]
    assert any("from memory, not checked at the source" in note for note in notes)
    rows = list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))
    assert (rows[0]["draw"], rows[0]["law"], rows[0]["number_in_fit"]) == ("0", "medians", "")
    assert float(rows[2]["sigma_squared [1]"]) == pytest.approx(float(rows[2]["sigma [1]"]) ** 2, rel=EXACT)
    assert float(rows[2]["e_inf_rig [J/kg]"]) == pytest.approx(1.24 * float(rows[2]["e_inf [J/kg]"]), rel=EXACT)


def test_the_rocky_file_calls_pyrocky_by_its_names_with_its_units():
    posterior = scattered(300)
    entry, table = answered(posterior)
    files = export("rocky", posterior, entry, table, 7)
    text = files["rocky_breakage.py"]
    ast.parse(text)
    draws = choose(posterior, entry, table, 7)
    calls = applied(text, draw=3)
    assert ("GetParticle", "rock") in calls
    assert ("SetBreakageModel", "professor_tavares") in calls
    assert ("SetT10Formula", "it10E_50b") in calls
    values = {call[1]: call[2] for call in calls if call[0] == "CreateVariable"}
    setters = {call[0]: call[1:] for call in calls if call[0] in PYROCKY}
    assert set(setters) == {name for name in PYROCKY if name.startswith("SetTavares")}
    for setter, (variable, *unit) in setters.items():
        assert PYROCKY[setter] in (*unit, "-")
        column, factor = variable.removeprefix("uq_"), 100.0 if PYROCKY[setter] == "%" else 1.0
        assert values[variable] == pytest.approx(factor * draws.columns[column][3], rel=EXACT)
    assert values["uq_sigma_squared"] == pytest.approx(draws.columns["sigma"][3] ** 2, rel=EXACT)
    assert values["uq_A"] == pytest.approx(55.0)
    assert "polyhedra only" in text


def test_rocky_has_vogel_and_peukert_as_ab_t10_and_says_what_is_from_memory():
    posterior = vogel_peukert()
    entry, table = answered(posterior, form="jk")
    text = export("rocky", posterior, entry, table, 4)["rocky_breakage.py"]
    calls = applied(text, draw=2)
    values = {call[1]: call[2] for call in calls if call[0] == "CreateVariable"}
    assert ("SetBreakageModel", "ab_t10") in calls
    size = values["uq_L_ref"]
    draws = choose(posterior, entry, table, 4)
    assert values["uq_S"] == pytest.approx(draws.columns["f_mat"][2] * size, rel=EXACT)
    assert values["uq_e_min_ref"] == pytest.approx(0.12 / size, rel=EXACT)
    assert "from memory, not checked at the source" in text


def test_what_rocky_and_edem_have_no_place_for_is_refused():
    weibull = known(40, law="weibull", size="weakest_link", ratio=math.inf, C=20.0, modulus=6.0, gamma=4.0)
    entry, table = answered(weibull)
    for target in ("rocky", "edem"):
        with pytest.raises(NotThere, match="fit"):
            export(target, weibull, entry, table, 2)
    king = replace(scattered(40), size="king")
    entry, table = answered(king)
    with pytest.raises(NotThere, match="tavares"):
        export("rocky", king, entry, table, 2)


def words(text, name):
    """The line of a fix, as words."""
    (line,) = [line for line in text.splitlines() if line.startswith(f"fix {name} ")]
    return line.split()


def after(parts, key, count=1):
    at = parts.index(key) + 1
    return [float(part) for part in parts[at : at + count]]


def test_liggghts_lines_are_read_back_by_its_own_grammar():
    posterior = vogel_peukert()
    entry, table = answered(posterior, form="jk", fines=0.004)
    files = export("liggghts", posterior, entry, table, 3)
    draws = choose(posterior, entry, table, 3)
    assert sorted(files) == ["draws.csv", *(f"liggghts_{k:02d}.in" for k in (1, 2, 3))]
    for k in (1, 2, 3):
        text = files[f"liggghts_{k:02d}.in"]
        assert "pair_style gran model hertz/break tangential history" in text
        template, broken = words(text, "pts"), words(text, "brk")
        assert template[3:6] == ["particletemplate/fragments", "11", "atom_type"]
        assert after(template, "constant") == [2700.0]
        assert after(template, "breakage_index", 2) == pytest.approx([0.55, 0.05])
        count = int(after(template, "tn_family")[0])
        assert after(template, "tn_family", count + 1)[1:] == [2.0, 5.0, 10.0, 20.0]
        assert broken[3] == "break/particle"
        assert after(broken, "fMat") == pytest.approx([draws.columns["f_mat"][k]], rel=EXACT)
        assert after(broken, "energy_threshold") == pytest.approx([0.12], rel=EXACT)
        assert after(broken, "min_radius") == pytest.approx([0.5 * entry.classes[-1].upper])
        assert "force_threshold" not in broken
        implied = float(re.search(r"fMat d = (\S+) t/kWh", text).group(1))
        assert implied == pytest.approx(3600.0 * draws.columns["f_mat"][k] * entry.reference_size, rel=1e-3)
        assert "measured 0.8" in text


def test_a_lognormal_law_meets_liggghts_at_two_energies():
    posterior = scattered(50)
    entry, table = answered(posterior)
    broken = words(export("liggghts", posterior, entry, table, 2)["liggghts_01.in"], "brk")
    (slope,), (least,) = after(broken, "fMat"), after(broken, "energy_threshold")
    row, d = choose(posterior, entry, table, 2).numbers[:1] - 1, entry.reference_size
    if least > 0.0:
        for share in (0.1587, 0.8413):
            energy = float(posterior.at(row).energy_at(share, d)[0])
            assert 1.0 - math.exp(-slope * d * (energy - least / d)) == pytest.approx(share, rel=1e-9)


def test_a_weibull_force_is_liggghts_force_threshold_exactly():
    weibull = known(10, law="weibull", size="weakest_link", ratio=math.inf, C=20.0, modulus=6.0, gamma=4.0)
    entry, table = answered(weibull)
    broken = words(export("liggghts", weibull, entry, table, 1)["liggghts_01.in"], "brk")
    (f_mat,), (f_0, m) = after(broken, "fMat"), after(broken, "force_threshold", 2)
    d, modulus = 0.012, 60e9 / (1.0 - 0.25**2)
    energy = float(weibull.energy_at(0.3, d)[0])
    force = float(laws.force_of_energy(energy, d, modulus, 2700.0))
    assert 1.0 - math.exp(-f_mat * d ** (3.0 - 2.0 * m) * (force / f_0) ** m) == pytest.approx(0.3, rel=1e-9)


def test_edem_gets_a_list_to_type_in():
    posterior = scattered(60)
    entry, table = answered(posterior)
    text = export("edem", posterior, entry, table, 3, 1.24)["edem_tavares.csv"]
    assert "were not seen" in text
    rows = list(csv.DictReader(io.StringIO("".join(f"{s}\n" for s in text.splitlines() if not s.startswith("#")))))
    first = {row["symbol"]: (float(row["value"]), row["unit"]) for row in rows if row["draw"] == "1"}
    assert first["E_inf (1 + k_p/k_s)"][0] == pytest.approx(1.24 * first["E_inf"][0], rel=EXACT)
    assert first["k_p"] == (pytest.approx(64e9), "Pa")
    assert first["d0"][1] == "m"


def test_the_command_exports_what_feed_wrote_in_under_a_second(tmp_path, capsys):
    posterior = scattered(4000)
    fit = tmp_path / "fit"
    fit.mkdir()
    about = FitEntry(law="lognormal", size="tavares", ratio=4.0, tested=(0.002, 0.08))
    (fit / "draws.csv").write_text(posterior.csv(), encoding="utf-8")
    (fit / "fit.json").write_text(about.model_dump_json(), encoding="utf-8")
    study = tmp_path / "s.toml"
    study.write_text(
        '[material]\nname = "limestone"\n[product]\nA = "55 %"\nb = 0.03\nform = "tavares"\n[feed]\nsizes = { law = '
        '"rosin_rammler", d63 = "30 mm", n = 1.2, top = "71.5 mm" }\nblows = 3\nenergy = { specific = "100 J/kg" }\n'
        'goal = { broken = 0.5, at_least = 0.9 }\n',
        encoding="utf-8",
    )  # fmt: skip
    out = tmp_path / "out"
    assert main(["feed", str(study), "--fit", str(fit), "--out", str(out), "--json"]) == 0
    answers = json.loads(capsys.readouterr().out)
    assert answers["goal"]["verdict"] == "met"
    assert 0.5 < answers["broken"]["value"] < 1.0
    for target in ("rocky", "liggghts", "edem", "csv"):
        assert main(["export-dem", str(out), "--to", target, "--out", str(tmp_path / target)]) == 0
    assert FINE.form == "jk"
    assert main(["feed", str(study), "--fit", str(fit), "--out", str(out), "--set", "feed.goal.broken=0.999"]) == 3
    assert main(["export-dem", str(tmp_path / "nowhere"), "--to", "csv"]) == 5
