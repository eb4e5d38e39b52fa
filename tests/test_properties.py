"""Properties of parser, store and statistics over inputs that nobody thought of."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from uqsphere.errors import StudyError
from uqsphere.store import csv_text, open_store
from uqsphere.study import load_study
from uqsphere.units import UNITS, UnitError, parse_value
from uqsphere.uq.describe import describe

#: the machine may be busy: an example has no time limit, the number of examples is the cost
QUIET = settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
FEW = settings(QUIET, max_examples=25)
ROUNDING = 1e-12
NUMBERS = st.floats(allow_nan=False, allow_infinity=False, width=64)
DIMENSIONAL = sorted(name for name in UNITS if name != "number")


# --- parser ---------------------------------------------------------------------------------------


def load_text(text: str | bytes) -> str:
    """What a study file comes to: "valid", or its faults; anything else is a failure of the test."""
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "s.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))
        try:
            load_study(path)
        except StudyError as error:
            found = error
        else:
            return "valid"
        lines = len(path.read_bytes().split(b"\n"))
    assert found.problems
    assert all(1 <= problem.line <= lines and problem.column >= 1 for problem in found.problems)
    return str(found)


@QUIET
@given(st.text(max_size=200))
@example("[" * 3000)
@example("a = " + "9" * 5000)
@example("a." * 3000 + "b = 1")
@example("[inputs]\nx = " + "{a = " * 200)
def test_any_text_is_a_study_or_has_faults_with_their_place(text: str) -> None:
    load_text(text)


@QUIET
@given(st.binary(max_size=200))
@example(b"\xef\xbb\xbf")
@example(b"\xff\xfea\0")
def test_any_bytes_are_a_study_or_have_faults(data: bytes) -> None:
    load_text(data)


@QUIET
@given(st.sampled_from(DIMENSIONAL), NUMBERS, st.data())
def test_a_value_is_its_number_times_its_unit(dimension: str, number: float, data: st.DataObject) -> None:
    unit = data.draw(st.sampled_from(sorted(UNITS[dimension])))
    expected = number * UNITS[dimension][unit]
    if math.isinf(expected):
        with pytest.raises(UnitError):
            parse_value(f"{number!r} {unit}", dimension)
    else:
        assert parse_value(f"{number!r} {unit}", dimension) == pytest.approx(expected, rel=ROUNDING, abs=1e-320)


@QUIET
@given(st.text(max_size=30), st.sampled_from(sorted(UNITS)))
@example("__import__('os')", "length")
@example("1e400 mm", "length")
@example("1+1 mm", "length")
@example("2_ mm", "length")
@example("1__0", "number")
def test_no_text_is_evaluated(text: str, dimension: str) -> None:
    try:
        value = parse_value(text, dimension)
    except UnitError:
        return
    assert math.isfinite(value)
    assert any(character.isdigit() for character in text)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1_000 mm", 1.0),
        ("1_0.2_5 m", 10.25),
        (".2_5 m", 0.25),
        ("1.e1_ m", None),
        ("1_ m", None),
        ("_1 m", None),
        ("1__0 m", None),
        ("\u0663 m", None),
    ],
)
def test_an_underscore_stands_between_two_digits(text: str, value: float | None) -> None:
    if value is not None:
        assert parse_value(text, "length") == value
        return
    with pytest.raises(UnitError):
        parse_value(text, "length")


# --- store ----------------------------------------------------------------------------------------

CHUNKS = arrays(np.float64, st.tuples(st.integers(0, 5), st.integers(1, 4)), elements=st.floats(width=64))


@FEW
@given(st.dictionaries(st.from_regex(r"[a-z]{1,8}\.[0-9]{1,3}\.[0-9]{1,2}", fullmatch=True), CHUNKS, max_size=5))
def test_chunks_come_back_bit_for_bit_and_apart(chunks: dict[str, np.ndarray]) -> None:
    with tempfile.TemporaryDirectory() as place:
        store = open_store(Path(place) / "r", {}, "", "0" * 64)
        try:
            for key, values in chunks.items():
                store.save(key, values)
            for key, values in chunks.items():
                found = store.load(key)
                assert (found.shape, found.tobytes()) == (values.shape, values.tobytes())
            assert store.load("another.0.0") is None
        finally:
            store.close()


@QUIET
@given(CHUNKS, st.integers(0, 10**6), st.integers(0, 7), st.sampled_from(["flip", "cut", "grow"]))
def test_no_damage_of_a_chunk_goes_unseen(values: np.ndarray, at: int, bit: int, how: str) -> None:
    with tempfile.TemporaryDirectory() as place:
        store = open_store(Path(place) / "r", {}, "", "0" * 64)
        try:
            store.save("k.0", values)
            (path,) = (Path(place) / "r" / "evaluations").iterdir()
            data = bytearray(path.read_bytes())
            if how == "flip":
                data[at % len(data)] ^= 1 << bit
            elif how == "cut":
                del data[at % len(data) :]
            else:
                data.append(bit)
            path.write_bytes(bytes(data))
            assert store.load("k.0") is None
        finally:
            store.close()


@QUIET
@given(st.lists(st.text(max_size=10), min_size=1, max_size=4))
def test_a_row_of_texts_comes_back_from_csv_but_for_formulas(cells: Sequence[str]) -> None:
    import csv
    import io

    assume(not any("\r" in cell or "\0" in cell for cell in cells))
    header, row = (
        list(csv.reader(io.StringIO(csv_text(cells, [cells]), newline="")))[:2] if any(cells) else (cells, cells)
    )
    for found in (header, row):
        for cell, given_cell in zip(found, cells, strict=True):
            assert cell in (given_cell, "'" + given_cell)
            assert not cell.startswith(("=", "+", "-", "@"))


# --- statistics -----------------------------------------------------------------------------------

SAMPLES = st.integers(0, 2**32 - 1).map(lambda seed: np.random.default_rng(seed).normal(size=(4, 64)))


@FEW
@given(SAMPLES, st.floats(1e-6, 1e6), st.floats(-1e6, 1e6))
def test_a_change_of_units_changes_answers_likewise(samples: np.ndarray, scale: float, shift: float) -> None:
    before, after = (describe(s, quantiles=(0.25, 0.5, 0.75)) for s in (samples, scale * samples + shift))
    slack = 1e-9 * (abs(shift) + scale)
    for a, b, move in (
        (before.mean, after.mean, shift),
        (before.sd, after.sd, 0.0),
        *((before.quantiles[p], after.quantiles[p], shift) for p in (0.25, 0.5, 0.75)),
    ):
        for key in ("value", "low", "high"):
            assert getattr(b, key) == pytest.approx(scale * getattr(a, key) + move, rel=1e-7, abs=slack)


@FEW
@given(SAMPLES, st.permutations(range(4)), st.integers(0, 2**32 - 1))
def test_answers_do_not_hang_on_the_order_of_what_is_alike(samples: np.ndarray, order: list[int], seed: int) -> None:
    shuffled = np.random.default_rng(seed).permuted(samples[order], axis=1)
    before, after = describe(samples, quantiles=(0.5,)), describe(shuffled, quantiles=(0.5,))
    assert after.mean.value == pytest.approx(before.mean.value, rel=1e-9, abs=1e-12)
    assert after.mean.half_width == pytest.approx(before.mean.half_width, rel=1e-6)
    assert after.quantiles[0.5].value == before.quantiles[0.5].value


@FEW
@given(SAMPLES)
def test_an_estimate_lies_in_its_interval_and_quantiles_in_their_order(samples: np.ndarray) -> None:
    found = describe(samples, quantiles=(0.1, 0.25, 0.5, 0.75, 0.9))
    values = [found.quantiles[p].value for p in (0.1, 0.25, 0.5, 0.75, 0.9)]
    assert values == sorted(values)
    for estimate in (found.mean, found.sd, *found.quantiles.values()):
        assert estimate.low <= estimate.value <= estimate.high
