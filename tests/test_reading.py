"""Numbers on the page: units that suit their size, digits that are read, paths without what nobody sees."""

from __future__ import annotations

import json
import math
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from report_folders import write_folder

from uqsphere.quantities import display_unit, format_estimate, format_value, lookup, reading_units, unit_that_reads
from uqsphere.report import build_report
from uqsphere.report.contents import units_of
from uqsphere.report.figures.canvas import slim
from uqsphere.report.phrases import estimate_text, index_cell, powers, probability_text
from uqsphere.results import Results
from uqsphere.results.entries import Est
from uqsphere.units import UNITS


def around(value: float, half: float) -> Est:
    return Est.of(value, value - half, value + half)


@pytest.mark.parametrize("name", ["P_max", "p_max", "contact_time", "energy", "sphere.radius", "striker.speed"])
def test_a_single_value_has_one_to_four_digits_before_its_point(name: str) -> None:
    dimension = UNITS[lookup(name).dimension]
    for exponent in np.linspace(-4.0, 4.0, 33):
        value = dimension[display_unit(name)[0]] * 10.0**exponent
        read = value / dimension[unit_that_reads(name, [value])]
        ladder_ends = exponent < -3.0 or exponent > 3.0
        assert 0.1 * (1 - 1e-9) <= read < 1e4 or ladder_ends


def test_the_usual_unit_stays_where_it_reads() -> None:
    assert unit_that_reads("P_max", [5.6e3, 830.0]) == "kN"
    assert unit_that_reads("P_max", [32.0]) == "N"
    assert unit_that_reads("striker.speed", [0.5]) == "m/s"
    assert unit_that_reads("sphere.nu", [0.02]) == ""
    assert unit_that_reads("P_max", []) == "kN"


def test_other_units_hold_inside_their_block_alone() -> None:
    with reading_units({"P_max": "N"}):
        assert format_value(32.0, "P_max") == "32 N"
        with reading_units({"p_max": "MPa"}):
            assert (display_unit("P_max")[0], display_unit("p_max")[0]) == ("N", "MPa")
    assert format_value(32.0, "P_max") == "0.032 kN"


def test_a_page_of_small_pressures_is_in_one_unit_and_its_files_in_si(tmp_path: Path) -> None:
    folder = write_folder(tmp_path)
    results = json.loads((folder / "results.json").read_text())
    name = next(iter(results["quantities"]))
    usual = display_unit(name)[0]
    before = (folder / "results.json").read_bytes()

    def smaller(entry: dict[str, float]) -> dict[str, float]:
        return {k: 1e-4 * v if k in ("value", "low", "high") and v is not None else v for k, v in entry.items()}

    entry = results["quantities"][name]
    entry["mean"], entry["sd"] = smaller(entry["mean"]), smaller(entry["sd"])
    entry["quantiles"] = {p: smaller(e) for p, e in entry["quantiles"].items()}
    assert units_of(Results.model_validate(results))[name] != usual
    (folder / "results.json").write_text(json.dumps(results))
    changed = (folder / "results.json").read_bytes()
    page = build_report(folder).read_text()
    table = re.search(rf"<caption[^>]*>{name}: values.*?</table>", page, re.DOTALL)
    assert units_of(Results.model_validate(results))[name] in table[0]
    assert usual not in table[0]
    assert (folder / "results.json").read_bytes() == changed != before


@pytest.mark.parametrize(
    ("estimate", "name", "text"),
    [
        (around(14.410841e6, 70.0), "core_tension", "14.411 MPa"),
        (around(0.548584, 0.00085), "striker.speed", "0.54858 (0.54773 to 0.54943) m/s"),
        (around(0.01, 5.3e-9), "sphere.radius", "10.000 mm"),
        (around(3.1e-7, 6e-7), "", "3.1 × 10⁻⁷ (−2.9 × 10⁻⁷ to 9.1 × 10⁻⁷)"),
    ],
)
def test_no_more_digits_than_are_read(estimate: Est, name: str, text: str) -> None:
    assert estimate_text(estimate, name) == text


def test_close_to_one_the_digits_are_of_what_is_missing() -> None:
    assert probability_text(around(0.9999555465, 9e-7)) == "99.995555 (99.995465 to 99.995645) %"


def test_indices_have_four_places_and_no_false_one() -> None:
    assert index_cell(around(0.99998552, 5e-7)) == "0.9999"
    assert index_cell(around(0.76196, 0.00069)) == "0.7620 (0.7613 to 0.7626)"
    assert index_cell(around(1e-6, 1e-7)) == "below 0.0001"


def test_exponents_become_powers_and_names_stay() -> None:
    assert powers("2.6e-09 of p_1e-3") == "2.6 × 10⁻⁹ of p_1e-3"


def test_a_slim_path_stays_within_what_is_seen() -> None:
    t = np.linspace(0.0, 2.0 * np.pi, 2001)
    x, y = 200.0 + 150.0 * np.cos(t), 100.0 + 40.0 * np.sin(3.0 * t)
    text = "M " + " \nL ".join(f"{a:.6f} {b:.6f}" for a, b in zip(x, y, strict=True)) + " \nz"
    found = slim(text)
    corners = np.array(re.findall(r"-?[\d.]+", found), dtype=float).reshape(-1, 2)
    assert len(found) < 0.1 * len(text)
    assert found.startswith("M")
    assert found.endswith("z")
    away = np.full(len(x), math.inf)
    for (ax, ay), (bx, by) in pairwise(corners):
        share = np.clip(((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2), 0.0, 1.0)
        away = np.minimum(away, np.hypot(x - ax - share * (bx - ax), y - ay - share * (by - ay)))
    assert away.max() < 0.06


def test_curves_keep_their_commands() -> None:
    assert slim("M 0 0 \nC 1.23456 0 2 1 3 1 \nz") == "M 0 0 \nC 1.23 0 2 1 3 1 \nz"


def test_numbers_at_the_ends_of_what_there_is_are_written() -> None:
    assert format_estimate(math.inf, -math.inf, 1.0, "p_max") == "inf (-inf to 1e-09) GPa"
    assert format_estimate(1.7e308, 1e300, 1.79e308).startswith("1.7")


def test_an_interval_that_is_far_longer_to_one_side_leaves_the_value_its_digits() -> None:
    """Rounded to two digits of the half-width it would be 100 (0 to 3200)."""
    assert format_estimate(51.66, 12.1, 3158.1) == "52 (12 to 3158)"
    # of what is nothing to its interval nothing is shown
    assert format_estimate(1e-9, 0.0, 0.02) == "0.000 (0.000 to 0.020)"
    assert format_estimate(0.999, 0.963, 1.0) == "0.999 (0.963 to 1.000)"
    assert unit_that_reads("p_max", [5e-324, 1.79e308]) in ("Pa", "kPa", "MPa", "GPa")
