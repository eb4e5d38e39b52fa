"""Feeds under repeated blows and how fine they break: closed forms, a brute simulation, published numbers."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uqsphere.feed import laws
from uqsphere.feed.fit import Posterior
from uqsphere.feed.population import Blows, Classes, Feed, Sizes, breaking, make_classes, populate, size_at
from uqsphere.feed.product import Curve, Product, drawn_curve, fit_alpha, fit_t10, milin_parameters
from uqsphere.uq.law import make_law

#: n of the columns of a published table of t_n
KNOTS = (1.2, 1.5, 2.0, 4.0, 25.0, 50.0, 75.0)
EXACT = 1e-12
CASES = json.loads((Path(__file__).parent / "data" / "feed_cases.json").read_text(encoding="utf-8"))
TRUTH = {"e_inf": 60.0, "d0": 0.006, "phi": 1.1, "sigma": 0.55, "gamma": 4.0}
FINE = Product(A=0.55, b=0.8 / 3600.0, curve=Curve(alpha=0.62))


def known(draws=1, *, law="lognormal", size="tavares", ratio=4.0, **parameters):
    """A posterior of draws that are all the same."""
    columns = {name: np.full(draws, value) for name, value in (parameters or TRUTH).items()}
    return Posterior(law=law, size=size, ratio=ratio, draws=columns, which=np.full(draws, law), tested=(0.002, 0.02))


def scattered(draws, seed=1):
    """A posterior like that of some fifty tests."""
    rng = np.random.default_rng(seed)
    columns = {name: value * np.exp(0.15 * rng.standard_normal(draws)) for name, value in TRUTH.items()}
    return replace(known(), draws=columns, which=np.full(draws, "lognormal"))


def rosin_rammler(d63=0.03, n=1.2, top=0.0715, count=14, ratio=2**0.5) -> Classes:
    return make_classes(Sizes(law="rosin_rammler", parameters={"d63": d63, "n": n}, top=top), ratio=ratio, count=count)


def fed(count=3, energy=100.0, kind="specific", classes=None, **more) -> Feed:
    return Feed(
        classes=classes or rosin_rammler(), blows=Blows(count=count, kind=kind, energy=energy), density=2700.0, **more
    )


# --- shares that are known in closed form -----------------------------------------------------------------


@pytest.mark.parametrize("blows", [1, 3, 10])
def test_classes_of_a_feed_break_as_the_cases_say(blows):
    case = CASES["F2"]
    feed = fed(blows, rest_breaks=True)
    assert feed.classes.mass == pytest.approx(case["mass"], rel=EXACT)
    assert feed.classes.sizes == pytest.approx(case["mid"], rel=EXACT)
    found = populate(breaking(known(), FINE, feed), FINE, feed)
    assert found.by_class[0] == pytest.approx(case[f"blows{blows}"]["truth_class"], rel=1e-6, abs=1e-12)
    assert found.broken[0] == pytest.approx(case[f"blows{blows}"]["truth_total"], rel=1e-6)


@pytest.mark.parametrize(("blows", "key"), [(1, "closed"), (5, "n5_gamma4")])
def test_a_lognormal_feed_of_a_power_law_has_a_closed_form(blows, key):
    case = CASES["F1"]
    law = {"d50": case["d50"], "log_sd": case["sd"]}
    sizes = Sizes(law="lognormal", parameters=law, top=case["d50"] * math.exp(7.0 * case["sd"]))
    classes = make_classes(sizes, ratio=1.005, count=2000)
    ore = known(size="power", ratio=math.inf, C=case["C"], phi=case["phi"], sigma=case["sigma"], gamma=4.0)
    found = breaking(ore, FINE, fed(blows, case["energy"], classes=classes))
    assert found.share.sum(axis=(1, 2)) @ classes.mass == pytest.approx(case[key], rel=1e-6)


def test_equal_blows_of_vogel_and_peukert_are_one_of_their_excess():
    case = CASES["F3"]
    classes = rosin_rammler(case["d63"], 1.0, 25 * case["d63"], 3000, 1.004)
    ore = known(law="vogel_peukert", f_mat=case["f_mat"], threshold=0.0, e_inf=1.0, d0=1.0, phi=1.0)
    three = breaking(ore, FINE, fed(case["k"], case["W"], classes=classes)).share.sum(axis=(1, 2))
    assert three @ classes.mass == pytest.approx(case["closed"], rel=1e-6)
    once = breaking(ore, FINE, fed(1, case["k"] * case["W"], classes=classes)).share.sum(axis=(1, 2))
    assert three == pytest.approx(once, rel=EXACT)


def test_without_scatter_what_is_coarser_than_one_size_breaks():
    classes = rosin_rammler(count=400, ratio=1.02)
    sharp = known(**{**TRUTH, "sigma": 1e-4})
    found = float((breaking(sharp, FINE, fed(3, classes=classes)).share.sum(axis=(1, 2)) @ classes.mass)[0])
    reach = 1.816583904953812 * 100.0
    # E50(d) e-star of the bound
    at = np.geomspace(1e-3, 0.0715, 200_000)
    stretched = reach / (1.0 - reach / (4.0 * laws.median_energy("tavares", at, TRUTH)))
    weak = (stretched > laws.median_energy("tavares", at, TRUTH)) | (stretched < 0.0)
    assert found == pytest.approx(1.0 - float(classes.passing(at[weak][:1])[0]), abs=0.02)


def test_a_blow_of_an_energy_weighs_on_the_size_and_a_speed_is_a_specific_energy():
    classes = rosin_rammler()
    mass = math.pi / 6.0 * 2700.0 * classes.sizes[3] ** 3
    by_energy = breaking(known(), FINE, fed(2, 100.0 * mass, kind="energy")).share.sum(axis=(1, 2))[0]
    plain = breaking(known(), FINE, fed(2, 100.0)).share.sum(axis=(1, 2))[0]
    by_speed = breaking(known(), FINE, fed(2, math.sqrt(200.0), kind="speed")).share.sum(axis=(1, 2))[0]
    assert by_energy[3] == pytest.approx(plain[3], rel=EXACT)
    assert by_energy[2] < plain[2]
    assert by_speed == pytest.approx(plain, rel=EXACT)


# --- spectra, progeny: a brute simulation ---------------------------------------------------------------------


def brute(energies, diameter, rng, particles):
    """Blow at which every particle breaks (n for never), blow by blow with the damage, independent of thresholds."""
    left = laws.LAWS["lognormal"].quantile(
        rng.random(particles),
        {"median": laws.median_energy("tavares", diameter, TRUTH), "sigma": TRUTH["sigma"], "ratio": 4.0},
    )
    at = np.full(particles, energies.shape[1])
    for k in range(energies.shape[1]):
        hit = (at == energies.shape[1]) & (energies[:, k] >= left)
        at[hit] = k
        left = laws.damaged(left, energies[:, k], TRUTH["gamma"])
    return at


def test_a_spectrum_of_blows_agrees_with_particles_one_by_one():
    law = make_law("lognormal", {"mean": 100.0, "sd": 60.0})
    classes = rosin_rammler()
    found = breaking(known(), FINE, fed(3, law))
    rng, particles = np.random.default_rng(5), 40_000
    for k in (2, 6):
        at = brute(law.ppf(rng.random((particles, 3))), classes.sizes[k], rng, particles)
        for blow in range(3):
            share = float((at == blow).mean())
            error = math.sqrt(share * (1.0 - share) / particles)
            assert float(found.share[0, blow, :, k].sum()) == pytest.approx(share, abs=4.0 * error + 4.0 * found.error)
    assert 0.0 < found.error < 2e-3


def test_a_spectrum_without_width_is_the_same_blow():
    narrow = make_law("lognormal", {"mean": 100.0, "sd": 1e-4})
    for form, b in (("jk", 0.8 / 3600.0), ("tavares", 0.03), ("shi_kojovic", 0.02)):
        product = replace(FINE, form=form, b=b)
        feeds = fed(3, narrow), fed(3)
        one, other = (populate(breaking(known(), product, feed), product, feed) for feed in feeds)
        assert one.by_class == pytest.approx(other.by_class, rel=1e-4)
        assert one.passing == pytest.approx(other.passing, rel=1e-3, abs=1e-6)


def test_fragments_that_stay_are_particles_of_their_class():
    """Two blows by hand: what the first makes is fresh before the second."""
    feed = fed(2, progeny="again", classes=rosin_rammler(count=5))
    classes, broken = feed.classes, breaking(known(), FINE, feed)
    found = populate(broken, FINE, feed)
    first = broken.share.sum(axis=2)[0, 0]
    fine = float(FINE.t10(np.array([100.0]))[0])
    made = np.zeros(6)
    for k, size in enumerate(classes.sizes):
        spread = size * 2.0 ** (0.25 - (np.arange(4) + 0.5) / 8.0)
        finer = np.array([FINE.curve.passing(spread / edge, np.array([fine]))[0].mean() for edge in classes.edges])
        made += classes.mass[k] * first[k] * np.append(finer[:-1] - finer[1:], finer[-1])
    made[-1] = 0.0  # the rest is not hit, and lies among the fines
    hit = classes.mass[:-1].sum() + (classes.mass * (1.0 - first) + made)[:-1].sum()
    assert found.energy[0] == pytest.approx(100.0 * hit, rel=1e-9)
    assert found.passing[0, -1] == pytest.approx(1.0, rel=EXACT)
    left = populate(broken, FINE, replace(feed, progeny="out"))
    edges = np.searchsorted(found.sieves, classes.edges * (1.0 - 1e-9))
    assert np.all(found.passing[0, edges] >= left.passing[0, edges] - EXACT)
    assert left.p80[0] < size_at(0.8, left.sieves, classes.passing(left.sieves)[None])[0]


# --- properties -------------------------------------------------------------------------------------------------

forms = st.sampled_from([("jk", 0.8 / 3600.0), ("tavares", 0.03), ("tavares_own", 0.03), ("shi_kojovic", 0.02)])
curves = st.sampled_from([Curve(alpha=0.5), Curve(law="milin"), Curve(law="beta", knots=tuple(
    (n, *(float(part) for part in milin_parameters(n))) for n in KNOTS))])  # fmt: skip


@settings(max_examples=25, deadline=None)
@given(forms, curves, st.integers(1, 4), st.floats(5.0, 2000.0), st.sampled_from(["out", "again"]), st.booleans())
def test_mass_is_kept_and_the_product_curve_rises(form, curve, blows, energy, progeny, lot):
    product = Product(form=form[0], A=0.6, b=form[1], curve=curve)
    feed = fed(blows, energy, progeny=progeny, lot=20.0)
    rng = np.random.default_rng(3) if lot else None
    broken = breaking(scattered(3), product, feed)
    found = populate(broken, product, feed, rng)
    assert found.passing[:, -1] == pytest.approx(1.0, abs=EXACT)
    assert np.all(np.diff(found.passing, axis=1) >= 0.0)
    assert np.all(found.passing >= 0.0)
    assert found.by_class @ feed.classes.mass == pytest.approx(found.broken, rel=EXACT)
    assert np.all(found.broken <= 1.0 + EXACT)
    assert np.all(found.blows <= blows + EXACT)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 6), st.floats(5.0, 500.0), st.floats(1.01, 3.0))
def test_more_blows_more_energy_and_weaker_rock_break_more(blows, energy, factor):
    def total(ore, n, e):
        return float((breaking(ore, FINE, fed(n, e)).share.sum(axis=(1, 2)) @ rosin_rammler().mass)[0])

    least = total(known(), blows, energy)
    assert total(known(), blows + 1, energy) > least
    assert total(known(), blows, factor * energy) > least
    assert total(known(**{**TRUTH, "e_inf": factor * TRUTH["e_inf"]}), blows, energy) < least


@pytest.mark.parametrize(("progeny", "octaves"), [("out", 0.5), ("again", 0.25)])
def test_classes_cut_in_two_move_p80_by_less_than_a_hundredth(progeny, octaves):
    both = (rosin_rammler(count=round(7 / width), ratio=2.0**width) for width in (octaves, 0.5 * octaves))
    one, other = (
        populate(breaking(known(), FINE, feed), FINE, feed)
        for feed in (fed(3, progeny=progeny, classes=classes) for classes in both)
    )
    assert one.p80[0] == pytest.approx(other.p80[0], rel=0.01)
    assert one.energy[0] == pytest.approx(other.energy[0], rel=0.02)


def test_a_lot_scatters_as_its_particles_and_ignorance_as_the_draws():
    """(F10) for 50 particles of one size, against lots that are drawn."""
    classes = make_classes(
        Sizes(law="gaudin_schuhmann", parameters={"top": 0.02, "n": 400.0}, top=0.02), ratio=1.02, count=1
    )
    particle = math.pi / 6.0 * 2700.0 * classes.sizes[0] ** 3
    feed = fed(3, 40.0, classes=classes, lot=50.0 * particle / classes.mass[0])
    broken = breaking(scattered(4_000), FINE, feed)
    share = broken.share.sum(axis=(1, 2))[:, 0]
    drawn = populate(broken, FINE, feed, np.random.default_rng(2)).by_class[:, 0]
    expected = share.var() + (share * (1.0 - share)).mean() / 50.0
    assert drawn.var() == pytest.approx(expected, rel=4.0 * math.sqrt(2.0 / 4_000))
    assert 50.0 * drawn == pytest.approx(np.round(50.0 * drawn), abs=1e-9)


# --- fineness -------------------------------------------------------------------------------------------------------


def test_curves_are_those_of_the_cases():
    for case in CASES["tn"]:
        for key, curve in (("trr08", Curve(alpha=0.8)), ("trr1", Curve(alpha=1.0)), ("milin", Curve(law="milin"))):
            assert curve.passing([case["n"]], case["t10"])[0] == pytest.approx(case[key], rel=1e-6)


def test_a_table_of_incomplete_beta_functions_passes_its_knots_and_t10():
    rows = tuple((n, *(float(part) for part in milin_parameters(n))) for n in KNOTS)
    curve, like = Curve(law="beta", knots=rows), Curve(law="milin")
    at = np.array(KNOTS)
    assert curve.passing(at, 0.3) == pytest.approx(like.passing(at, 0.3), rel=1e-9)
    assert curve.passing([10.0], 0.3)[0] == pytest.approx(0.3, rel=EXACT)
    many = curve.passing(np.geomspace(1.01, 500.0, 300), np.array([0.05, 0.4]))
    assert np.all(np.diff(many, axis=1) <= 1e-15)
    assert np.all(many > 0.0)


def test_published_numbers_of_an_smc_test_are_met():
    """Sample A of a published SMC output, A 87.9 %, b 0.31 t/kWh: energies for t10 of 10, 20 and 30 % at 28.9 mm."""
    product = Product(A=0.879, b=0.31 / 3600.0)
    for fine, published in ((0.10, 0.39), (0.20, 0.82), (0.30, 1.31)):
        energy = -math.log(1.0 - fine / 0.879) / 0.31
        assert product.t10(np.array([3600.0 * energy]))[0] == pytest.approx(fine, rel=EXACT)
        assert energy == pytest.approx(published, rel=0.03)
    # energies for one t10 at 14.5 and 57.8 mm: the published exponent of size
    slopes = [
        math.log(small / large) / math.log(57.8 / 14.5) for small, large in ((0.51, 0.29), (1.11, 0.61), (1.83, 0.95))
    ]
    assert all(0.405 < slope < 0.475 for slope in slopes)


def test_a_and_b_from_few_tests_are_told_together_only():
    rng = np.random.default_rng(4)
    x = 3600.0 * np.array([0.1, 0.25, 0.5, 0.75, 1.0])
    fine = FINE.t10(x) * np.exp(0.07 * rng.standard_normal(5))
    best, A, b = fit_t10(x, fine, 4000, rng)
    assert best["Ab"] == pytest.approx(0.55 * 0.8 / 3600.0, rel=0.2)
    assert np.corrcoef(np.log(A), np.log(b))[0, 1] < -0.9
    assert np.log(A * b).std() < 0.5 * np.log(A).std()
    assert A.max() <= 1.0
    with pytest.raises(ValueError, match="take three at least"):
        fit_t10(x[:2], fine[:2], 10, rng)


def test_contours_of_a_and_b_hold_the_truth_as_often_as_they_say():
    rng, inside, runs = np.random.default_rng(6), 0, 100
    x = 3600.0 * np.geomspace(0.1, 2.5, 8)
    for _ in range(runs):
        _, A, b = fit_t10(x, FINE.t10(x) * np.exp(0.07 * rng.standard_normal(8)), 1000, rng)
        low, high = np.quantile(A * b, (0.025, 0.975))
        inside += low <= 0.55 * 0.8 / 3600.0 <= high
    assert inside / runs == pytest.approx(0.95, abs=4.0 * math.sqrt(0.95 * 0.05 / runs))


def test_the_exponent_of_sieve_curves_is_found_again():
    rng = np.random.default_rng(2)
    fine = rng.uniform(0.05, 0.6, 12)
    n = np.tile([2.5, 6.0, 20.0, 45.0, np.nan], (12, 1))
    n[:, -1] = 4.0
    passing = np.stack([Curve(alpha=0.45).passing(row, t) for row, t in zip(n, fine, strict=True)])
    passing[:, -1] = np.nan
    alpha, misfit, draws = fit_alpha(n, fine, passing + 0.002 * rng.standard_normal(passing.shape), 2000, rng)
    assert alpha == pytest.approx(0.45, rel=0.03)
    assert misfit < 0.01
    assert np.quantile(draws, 0.025) < 0.45 < np.quantile(draws, 0.975)


def test_a_discrepancy_scatters_t_n_by_five_hundredths_and_keeps_its_ends():
    curve = drawn_curve(Curve(alpha=0.6), 4000, np.random.default_rng(1))
    at = float(np.exp(np.log(9.0) / 1.0))
    half = curve.passing([10.0], np.full(4000, 0.5))[:, 0]
    assert half.std() == pytest.approx(0.05, rel=0.05)
    assert curve.passing([1.0, at], np.full(4000, 0.3))[:, 0] == pytest.approx(1.0, rel=EXACT)


def test_sieves_of_a_table_are_joined_in_the_logarithm():
    sizes = Sizes(sieves=(0.004, 0.016, 0.063), finer=(0.2, 0.6, 1.0), top=0.063)
    assert sizes.passing(np.array([0.008, 0.002])) == pytest.approx([0.4, 0.1])
    classes = make_classes(sizes, ratio=2.0, count=4)
    assert classes.mass.sum() == pytest.approx(1.0, rel=EXACT)
