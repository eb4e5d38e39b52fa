"""Rows in, columns out: the impact model against closed forms, names and indices, and what a black
box may return.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import uqsphere
from uqsphere.errors import AccessError, ModelError, UsageError
from uqsphere.mechanics import closed_form
from uqsphere.mechanics.outputs import OUTPUTS
from uqsphere.models.black_box import call_black_box, read_model
from uqsphere.models.evaluate import evaluate
from uqsphere.models.model import Model
from uqsphere.models.scene import absent_quantity, check_scene, evaluate_scene, scene_of
from uqsphere.propagation.design import Design
from uqsphere.study import Study, load_study, shipped_studies

BARS = """
seed = 1
[sphere]
E = { dist = "lognormal", mean = "52 GPa", cov = 0.1 }
nu = 0.25
radius = { dist = "normal", mean = "10 mm", sd = "0.1 mm" }
density = "2650 kg/m3"
[bars]
E = "210 GPa"
nu = 0.3
density = "7850 kg/m3"
yield_strength = "1500 MPa"
diameter = "60 mm"
infinite = true
rigid_contact = true
[striker]
speed = { dist = "normal", mean = "1 m/s", cov = 0.1 }
[pulse]
shape = "step"
[model]
fidelity = "massless"
horizon = "100 ms"
[limits.crushing]
quantity = "p_max"
strength = "3 GPa"
[margins]
solve = "striker.speed"
between = ["0.1 m/s", "5 m/s"]
[analysis]
quantities = ["p_max"]
"""

BLOW = """
seed = 1
[sphere]
E = { dist = "lognormal", mean = "60 GPa", cov = 0.1 }
nu = 0.25
radius = "5 mm"
density = "2650 kg/m3"
[rig]
kind = "impact"
speed = "5 m/s"
[contact]
law = "hertz"
[target]
kind = "thick"
E = "210 GPa"
nu = 0.3
yield_strength = "2000 MPa"
[limits.crushing]
quantity = "p_max"
strength = "3 GPa"
[analysis]
quantities = ["p_max"]
"""


@pytest.fixture(scope="module")
def bars() -> Study:
    return load_study(text=BARS)


@pytest.fixture(scope="module")
def blow() -> Study:
    return load_study(text=BLOW)


def table(count: int, seed: int = 1) -> pd.DataFrame:
    """Rows of the random inputs of `BARS`."""
    rng = np.random.default_rng(seed)
    return pd.DataFrame(
        {
            "sphere.E": 52e9 * np.exp(0.1 * rng.standard_normal(count)),
            "sphere.radius": 0.01 + 1e-4 * rng.standard_normal(count),
            "striker.speed": rng.uniform(0.5, 2.0, count),
        },
        index=[f"row {k}" for k in range(count)],
    )


# --- the impact model -----------------------------------------------------------------------------


def test_a_step_on_a_massless_sphere_is_its_closed_form(bars: Study) -> None:
    """Rigid contact: the force rises to Z v0, and p_max = (6 P E*^2/(pi^3 r^2))^(1/3) with 1/E* =
    (1 - nu^2)/E.
    """
    rows = table(20)
    impedance = math.sqrt(210e9 * 7850.0) * math.pi / 4.0 * 0.06**2
    modulus = rows["sphere.E"] / (1.0 - 0.25**2)
    force = 0.5 * impedance * rows["striker.speed"]
    expected = np.cbrt(6.0 * force * modulus**2 / (math.pi**3 * rows["sphere.radius"] ** 2))
    found = evaluate(bars, rows, "p_max")
    assert list(found.columns) == ["p_max", "censored"]
    np.testing.assert_allclose(found["p_max"], expected, rtol=1e-9)


def test_a_blow_on_a_thick_block_is_that_of_hertz(blow: Study) -> None:
    """P_max = beta^(2/5) (5/4 m v^2)^(3/5), beta = 4/3 E* sqrt(r), p_max = (6 P E*^2/(pi^3
    r^2))^(1/3).
    """
    E, speed = np.array([40e9, 60e9, 80e9]), np.array([1.0, 5.0, 3.0])
    modulus = 1.0 / ((1.0 - 0.25**2) / E + (1.0 - 0.3**2) / 210e9)
    beta = 4.0 / 3.0 * modulus * math.sqrt(0.005)
    mass = 4.0 / 3.0 * math.pi * 0.005**3 * 2650.0
    force = beta**0.4 * (1.25 * mass * speed**2) ** 0.6
    found = evaluate(blow, {"sphere.E": E, "rig.speed": speed}, ("P_max", "p_max"))
    np.testing.assert_allclose(found["P_max"], force, rtol=1e-12)
    np.testing.assert_allclose(
        found["p_max"], np.cbrt(6.0 * force * modulus**2 / (math.pi**3 * 0.005**2)), rtol=1e-12
    )


def test_rows_that_have_a_closed_form_are_no_others(blow: Study) -> None:
    """On a bar the echo decides row by row which sphere is answered in closed form: each as by
    itself.
    """
    text = BLOW.replace(
        'kind = "thick"',
        'kind = "bar"\ndiameter = "40 mm"\nlength = "0.05 m"\ndensity = "7850 kg/m3"',
    )
    study = load_study(text=text)
    radius = np.linspace(1e-3, 9e-3, 12)
    together = evaluate(study, {"sphere.radius": radius}, "p_max", 1e-8)["p_max"]
    alone = [evaluate(study, {"sphere.radius": r}, "p_max", 1e-8)["p_max"][0] for r in radius]
    scene = scene_of(study, {"sphere.radius": radius})
    assert 0 < closed_form.closed_form_rows(scene).sum() < 12
    assert together.to_list() == alone
    assert np.isfinite(alone).all()


def test_blocks_and_threads_change_no_bit(bars: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = table(700)
    names = tuple(rows.columns)
    found = []
    for most, threads in ((16_384, None), (100, 2), (33, 1)):
        monkeypatch.setattr("uqsphere.models.model.LARGEST_CALL", most)
        with Model(bars, threads=threads) as model:
            answers = model.evaluate(names, rows.to_numpy(), ("p_max", "P_max"))
            assert (model.evaluations, model.reused) == (700, 0)
        found.append(answers.values.tobytes())
    assert found[0] == found[1] == found[2]


@pytest.mark.parametrize(
    ("column", "bad"),
    [("sphere.E", -1.0), ("sphere.nu", 0.5), ("sphere.radius", 0.04), ("striker.speed", 0.0)],
)
def test_a_row_without_meaning_has_a_status_a_reason_and_no_number(
    bars: Study, column: str, bad: float
) -> None:
    good = bars.at_means()[column]
    with Model(bars) as model:
        answers = model.evaluate((column,), np.array([[good], [bad], [good]]), ("p_max",))
    assert answers.status.tolist() == [0, 1, 0]
    assert np.isnan(answers.values[:, 0]).tolist() == [False, True, False]
    assert f"at {column} = {bad:.6g}" in answers.note
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        frame = evaluate(bars, {column: [good, bad, good]}, "p_max")
    assert "1 of 3 rows have no answer" in str(caught[-1].message)
    assert frame["p_max"].isna().tolist() == [False, True, False]


def test_what_the_rig_has_not_is_refused_by_its_place(blow: Study, bars: Study) -> None:
    check_scene(blow)
    check_scene(bars)
    wrong = load_study(
        text=BLOW.replace('quantities = ["p_max"]', 'quantities = ["mean_force_max", "dent"]')
    )
    with pytest.raises(UsageError, match=r"analysis\.quantities"):
        check_scene(wrong)
    with pytest.raises(UsageError, match=r"margins\.between: 0 m/s|margins\.between"):
        check_scene(
            load_study(
                text=BARS.replace('solve = "striker.speed"', 'solve = "sphere.radius"').replace(
                    '["0.1 m/s", "5 m/s"]', '["1 mm", "40 mm"]'
                )
            )
        )
    with pytest.raises(UsageError, match=r"sphere\.colour"):
        scene_of(bars, {"sphere.colour": np.array([1.0])})


# --- names and indices ----------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(order=st.permutations(range(3)), rows=st.permutations(range(6)), seed=st.integers(0, 5))
def test_names_and_labels_count_not_the_order(order: list[int], rows: list[int], seed: int) -> None:
    study = load_study(text=BARS)
    frame = table(6, seed)
    expected = evaluate(study, frame, "p_max")
    mixed = frame.iloc[rows, order]
    found = evaluate(study, mixed, "p_max")
    assert found.index.equals(mixed.index)
    pd.testing.assert_frame_equal(found.loc[frame.index], expected)
    columns = {
        name: mixed[name].iloc[np.roll(np.arange(6), k)] for k, name in enumerate(mixed.columns)
    }
    by_index = evaluate(study, columns, "p_max")
    pd.testing.assert_frame_equal(by_index.loc[frame.index], expected)
    arrays = {name: mixed[name].to_numpy() for name in mixed.columns}
    assert (evaluate(study, arrays, "p_max")["p_max"].to_numpy() == found["p_max"].to_numpy()).all()
    with Model(study) as model:
        names = tuple(mixed.columns)
        assert (
            model.evaluate(names, mixed.to_numpy(), ("p_max",)).values[:, 0]
            == found["p_max"].to_numpy()
        ).all()


def test_numbers_spread_and_what_a_dict_leaves_out_is_the_mean(bars: Study) -> None:
    whole = bars.at_means() | {"striker.speed": np.array([1.0, 2.0])}
    found = evaluate(bars, whole, ("p_max", "P_max"))
    pd.testing.assert_frame_equal(
        found, evaluate(bars, {"striker.speed": [1.0, 2.0]}, ("p_max", "P_max"))
    )
    assert found.index.equals(pd.RangeIndex(2))
    one = evaluate(bars, bars.at_means(), "p_max")
    assert one["p_max"].tolist() == [found["p_max"][0]]
    assert evaluate(bars, {"striker.speed": []}).shape == (0, 2)
    assert evaluate(bars, {}).columns.tolist() == ["p_max", "censored"]


@pytest.mark.parametrize(
    ("rows", "options", "text"),
    [
        (pd.DataFrame({"sphere.E": [5e10]}), {}, "'sphere.radius' is missing"),
        (pd.concat([table(2), table(2)], axis=1), {}, "'sphere.E' is given 2 times"),
        (table(2).assign(colour=1.0), {}, "unknown input 'colour'"),
        ({"limits.crushing.strength": [1.0]}, {}, "unknown input"),
        ({"hammer.speed": [1.0]}, {}, "unknown input"),
        (
            {"sphere.E": [5e10, 6e10], "striker.speed": [1.0, 2.0, 3.0]},
            {},
            "differ in length: 2, 3",
        ),
        ({"sphere.E": [[5e10, 6e10]]}, {}, r"shape \(n, 1\) are required"),
        ({"striker.speed": ["0.5 m/s"]}, {}, "no columns of numbers"),
        (
            {"sphere.E": pd.Series([5e10], ["a"]), "striker.speed": pd.Series([1.0], ["b"])},
            {},
            "is not that of the rows",
        ),
        ([1.0, 2.0], {}, "DataFrame or a dict"),
        ({"sphere.E": [5e10, math.nan]}, {}, "no finite number in row 2"),
        ({}, {"quantities": ("p_min",)}, "p_min"),
        ({}, {"tolerance": 0.0}, "tolerance"),
        ({}, {"tolerance": math.nan}, "tolerance"),
        ({}, {"tolerance": "1e-6"}, "tolerance"),
        ({1: [1.0]}, {}, "unknown input '1'"),
        ({"sphere.E": [5e10 + 1j]}, {}, "complex numbers"),
        ({"sphere.E": [None, pd.NA]}, {}, "no columns of numbers.*NAType"),
        ({}, {"study": "granite.toml"}, "study must be a Study, as load_study returns it, not str"),
        ({}, {"threads": 0}, "threads"),
        ({}, {"model": lambda x: x}, "impact scene"),
    ],
)
def test_wrong_rows_are_refused(bars: Study, rows: Any, options: dict[str, Any], text: str) -> None:
    with pytest.raises(UsageError, match=text):
        evaluate(options.pop("study", bars), rows, **options)


@pytest.mark.parametrize(
    "values", [{"sphere.E": 52.0}, {"sphere.radius": 5.0}, {"sphere.density": 2.65}]
)
def test_a_number_far_from_the_usual_is_warned_of(bars: Study, values: dict[str, float]) -> None:
    name = next(iter(values))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        evaluate(bars, values)
    assert f"{name} = {values[name]:g}" in str(caught[0].message)
    assert "is the unit right?" in str(caught[0].message)


# --- what a black box gets and returns ------------------------------------------------------------

BOX = """
seed = 1
[inputs]
a = { dist = "uniform", lower = 0.0, upper = 1.0 }
b = 3.0
[outputs]
names = ["y", "z"]
"""
A = np.linspace(0.1, 0.9, 4)
EXPECTED = np.stack([A + 3.0, 2.0 * A], axis=1)

#: forms in which the same answers may come
FORMS: dict[str, Any] = {
    "a dict": lambda x: {"z": 2 * x["a"], "y": x["a"] + x["b"], "more": None},
    "lists": lambda x: {"y": list(x["a"] + x["b"]), "z": tuple(2 * x["a"])},
    "objects": lambda x: {"y": (x["a"] + x["b"]).astype(object), "z": 2 * x["a"]},
    "a DataFrame": lambda x: pd.DataFrame({"z": 2 * x["a"], "y": x["a"] + x["b"]}),
    "a sorted DataFrame": lambda x: pd.DataFrame(
        {"z": 2 * x["a"], "y": x["a"] + x["b"]}
    ).sort_values("z")[::-1],
    "Series": lambda x: {
        "y": pd.Series(x["a"] + x["b"])[::-1],
        "z": pd.Series(2 * x["a"], index=list("abcd")[: len(x["a"])]),
    },
    "an array": lambda x: np.stack([x["a"] + x["b"], 2 * x["a"]], axis=1),
}

#: what is no answer, and why
WRONG: dict[str, tuple[Any, str]] = {
    "missing": (lambda x: {"y": x["a"]}, "no 'z'"),
    "empty": (lambda x: {}, "returned nothing"),
    "none": (lambda x: None, "must return a dict with 'y', 'z'"),
    "one array": (lambda x: x["a"], r"must return a dict with 'y', 'z'"),
    "transposed": (lambda x: np.stack([x["a"], x["a"]]), r"shape \(4, 2\)"),
    "short": (lambda x: {"y": x["a"], "z": x["a"][:2]}, r"must have shape \(4,\)"),
    "one number": (lambda x: {"y": x["a"], "z": 1.0}, "numpy.vectorize"),
    "two dimensions": (lambda x: {"y": x["a"], "z": x["a"][:, None]}, r"not \(4, 1\)"),
    "text": (lambda x: {"y": x["a"], "z": ["1", "2", "3", "4"]}, "not an array of numbers"),
    "objects": (
        lambda x: {"y": x["a"], "z": np.array([1, 2, 3, "x"], dtype=object)},
        "not an array of numbers",
    ),
    "dates": (lambda x: {"y": x["a"], "z": np.zeros(4, "M8[s]")}, "not an array of numbers"),
    "complex": (lambda x: {"y": x["a"], "z": x["a"] + 1j}, "complex"),
    "repeated": (
        lambda x: pd.DataFrame(np.zeros((4, 3)), columns=["y", "z", "y"]),
        r"not \(4, 2\)",
    ),
    "raises": (lambda x: 1 / 0, "ZeroDivisionError"),
    "generator": (lambda x: (a for a in x["a"]), "must return a dict"),
}


@pytest.mark.parametrize("form", FORMS)
def test_answers_may_come_in_many_forms(form: str) -> None:
    def box(x: dict[str, np.ndarray[Any, Any]]) -> Any:
        assert {name: column.dtype for name, column in x.items()} == {
            "a": np.float64,
            "b": np.float64,
        }
        return FORMS[form](x)

    study = load_study(text=BOX)
    with Model(study, box) as model:
        answers = model.evaluate(("a",), A[:, None], ("y", "z"))
        assert (answers.values == EXPECTED).all()
        assert (model.evaluate(("a",), A[:, None], ("z",)).values == EXPECTED[:, 1:]).all()
    frame = pd.DataFrame({"a": A}, index=list("wxyz"))
    found = evaluate(study, frame, model=box)
    assert found.columns.tolist() == ["y", "z", "censored"]
    assert found.index.tolist() == list("wxyz")


@pytest.mark.parametrize("name", WRONG)
def test_answers_of_another_form_are_refused(name: str) -> None:
    box, text = WRONG[name]
    with pytest.raises(ModelError, match=text):
        call_black_box(box, ("a",), A[:, None], ("y", "z"))


def test_one_output_and_one_row_need_no_dict() -> None:
    assert (
        call_black_box(lambda x: 2 * x["a"], ("a",), A[:, None], ("y",)).tolist()
        == EXPECTED[:, 1:].tolist()
    )
    assert call_black_box(lambda x: 2.0, ("a",), A[:1, None], ("y",)).tolist() == [[2.0]]
    masked = np.ma.array([1.0, 2.0], mask=[False, True])
    assert np.isnan(call_black_box(lambda x: masked, ("a",), A[:2, None], ("y",))[1, 0])
    assert np.isnan(call_black_box(lambda x: [1.0, None], ("a",), A[:2, None], ("y",))[1, 0])


def test_what_a_model_does_about_errors_of_numpy_is_set_back() -> None:
    def box(x: dict[str, Any]) -> Any:
        np.seterr(all="raise")
        return {"y": x["a"], "z": x["b"]}

    settings = np.geterr()
    assert call_black_box(box, ("a", "b"), np.zeros((2, 2)), ("y", "z")).tolist() == [
        [0.0, 0.0],
        [0.0, 0.0],
    ]
    assert np.geterr() == settings


def test_unknown_inputs_and_outputs_are_refused() -> None:
    with Model(load_study(text=BOX), FORMS["a dict"]) as model:
        for names, columns, text in (
            (("q",), ("y",), "unknown input 'q'"),
            (("a",), ("q",), "unknown output 'q'"),
        ):
            with pytest.raises(UsageError, match=text):
                model.check_names(names, columns)


# --- loading --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "reference", ["model.py", "model.txt:f", "model.py:", "model.py:not a name", ":f", ""]
)
def test_malformed_references_are_refused(reference: str) -> None:
    with pytest.raises(UsageError, match=r"FILE\.py:FUNCTION"):
        read_model(reference)


def test_models_that_cannot_be_had(tmp_path: Path) -> None:
    with pytest.raises(AccessError, match="there is no such file"):
        read_model(f"{tmp_path / 'none.py'}:f")
    file = tmp_path / "model.py"
    for text, kind, message in (
        ("x = 1\ndef g(x): pass\n", UsageError, r"no function 'f'; its functions: g"),
        ("f = 1\n", UsageError, "no function 'f'"),
        ("1 / 0\n", ModelError, r"ZeroDivisionError: division by zero \(model.py, line 1\)"),
        ("def f(:\n", ModelError, "SyntaxError"),
        ("import sys\nsys.exit(0)\n", ModelError, "SystemExit"),
    ):
        file.write_text(text)
        with pytest.raises(kind, match=message):
            read_model(f"{file}:f").load()
    file.write_text("def f(x):\n    return 2 * x['a']\n")
    assert read_model(f"{file}:f").load()({"a": np.array([1.5])}).tolist() == [3.0]
    (tmp_path / "beside_the_model.py").write_text("K = 3.0\n")
    file.write_text("from beside_the_model import K\ndef f(x):\n    return K * x['a']\n")
    assert read_model(f"{file}:f").load()({"a": np.array([1.5])}).tolist() == [4.5]


SHIPPED = [
    "granite",
    "glass_bead_small_bar",
    "limestone_drop_weight",
    "quartz_load_cell",
    "limestone_rotor",
]


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_a_quantity_asked_for_by_itself_is_that_among_all(name: str) -> None:
    study = load_study(shipped_studies()[name])
    quantities = tuple(key for key in OUTPUTS if not absent_quantity(study, key))
    row = {"sphere.nu": np.array([0.2])}
    together = evaluate(study, row, quantities=quantities).iloc[0]
    assert len(quantities) > 15
    for key in quantities:
        single = evaluate(study, row, quantities=(key,)).iloc[0]
        assert single[key] == pytest.approx(together[key], rel=1e-5, nan_ok=True), key
        assert np.isfinite(together[key]), key


def test_the_load_cell_of_any_length_has_answers() -> None:
    """With rods of 0.25 to 0.305 m the sphere follows the rod, whose echoes hold the gap open: each
    row took a million steps, and had none.
    """
    study = load_study("studies/quartz_load_cell.toml")
    asked = ("p_max", "contact_duration", "loaded_time")
    lengths = np.linspace(0.05, 1.0, 96)
    found = evaluate(study, {"rod.length": lengths}, quantities=asked)
    assert np.isfinite(found[list(asked)].to_numpy()).all()
    # no echo comes before the largest force in a rod of more than 0.21 m, and that of a free end
    # only takes from the duration
    longest = found.iloc[-1]
    assert found["p_max"][lengths > 0.21].to_numpy() == pytest.approx(longest["p_max"], rel=1e-4)
    assert (found["contact_duration"] <= longest["contact_duration"] * (1.0 + 1e-4)).all()


def test_a_row_without_meaning_has_a_status_and_warns_nobody() -> None:
    granite = Design.of(load_study("studies/granite.toml")).study  # with the modes of the library
    found = evaluate_scene(
        granite,
        ("sphere.radius",),
        np.array([[-0.01], [0.01]]),
        ("p_max", *(limit.quantity for limit in granite.limits)),
    )
    assert found.good.tolist() == [False, True]
    assert np.isnan(found.values[0]).all()
    assert np.isfinite(found.values[1]).all()


def test_the_first_peak_of_a_closed_form_is_its_largest(blow: Study) -> None:
    """Rows in closed form stand beside integrated ones, and every quantity is answered in both."""
    bar = 'kind = "bar"\ndiameter = "40 mm"\nlength = "0.05 m"\ndensity = "7850 kg/m3"'
    study = load_study(text=BLOW.replace('kind = "thick"', bar))
    radius = np.array([1e-3, 9e-3])
    assert closed_form.closed_form_rows(scene_of(study, {"sphere.radius": radius})).any()
    found = evaluate(study, {"sphere.radius": radius}, ("p_max", "first_peak"))
    assert found["first_peak"][0] == found["p_max"][0]


def test_evaluate_warns_outside_the_range_of_the_model(blow: Study) -> None:
    soft = {"sphere.E": 1.5e8, "rig.speed": 40.0}
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        evaluate(blow, soft, "p_max")
    texts = [str(warning.message) for warning in told]
    assert any("outside the validity range of the model" in t for t in texts)


def _by_name(x: dict[str, Any], order: Sequence[str]) -> Any:
    """Answers y = a + 2 b and z = a - b, a row for each output, in this order."""
    xarray = pytest.importorskip("xarray")
    answers = {"y": x["a"] + 2.0 * x["b"], "z": x["a"] - x["b"]}
    rows = np.array([answers[name] for name in order])
    return xarray.DataArray(rows, dims=("output", "row"), coords={"output": list(order)})


def _dataset(x: dict[str, Any]) -> Any:
    labelled = _by_name(x, ("z", "y"))
    return labelled.to_dataset(dim="output")


def _shuffled(x: dict[str, Any]) -> Any:
    """A dataset whose coordinate numbers the rows backwards."""
    labelled = _by_name(x, ("y", "z")).assign_coords(row=np.arange(len(x["a"])))
    return labelled.isel(row=slice(None, None, -1)).to_dataset(dim="output")


@pytest.mark.parametrize(
    "box",
    [
        lambda x: _by_name(x, ("y", "z")),
        lambda x: _by_name(x, ("z", "y")),
        lambda x: _by_name(x, ("z", "y")).T,
        _dataset,
        _shuffled,
    ],
)
def test_labelled_arrays_are_read_by_name(box: Any) -> None:
    rows = np.array([[1.0, 2.0], [3.0, 5.0]])  # as many as outputs: a place could be mistaken
    answers = call_black_box(box, ("a", "b"), rows, ("y", "z"))
    assert answers.tolist() == [[5.0, -1.0], [13.0, -2.0]]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.array([1.0 + 0j, 2.0]), "its type is complex"),
        (np.array([np.complex128(1 + 2j), 2.0], dtype=object), "its type is complex"),
        ([1 + 2j, 3.0], "complex"),
        (np.array(["1", "2"]), "its type is <U1"),
        (np.array([np.datetime64("2020-01-01")] * 2), "datetime64"),
    ],
)
def test_answers_that_are_no_real_numbers_are_refused(value: Any, text: str) -> None:
    with pytest.raises(ModelError, match=f"the model's 'y' is not an array of numbers.*{text}"):
        call_black_box(lambda x: {"y": value}, ("a",), np.zeros((2, 1)), ("y",))


def test_a_model_without_a_return_is_refused() -> None:
    with pytest.raises(ModelError, match="with 'y', or an array of shape \\(2, 1\\), not NoneType"):
        call_black_box(lambda x: None, ("a",), np.zeros((2, 1)), ("y",))


def test_a_labelled_array_without_the_names_of_the_outputs_is_refused() -> None:
    named = _by_name({"a": np.zeros(2), "b": np.zeros(2)}, ("y", "z"))
    unnamed = named.assign_coords(output=["p", "q"])
    with pytest.raises(ModelError, match="must have a coordinate with 'y', 'z'"):
        call_black_box(lambda x: unnamed, ("a",), np.zeros((2, 1)), ("y", "z"))


def test_what_a_mask_hides_is_no_answer() -> None:
    masked = np.ma.masked_array([1.0, 2.0, 3.0], [False, True, False])
    for value in (masked, masked.astype(object), [1.0, np.ma.masked, 3.0]):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy's own on the list
            answers = call_black_box(lambda x, v=value: {"y": v}, ("a",), np.zeros((3, 1)), ("y",))
        np.testing.assert_array_equal(answers[:, 0], [1.0, np.nan, 3.0])


class Pressed:
    """What a user interrupts while it is read."""

    def __array__(self, *_: Any, **__: Any) -> np.ndarray:
        raise KeyboardInterrupt

    def __str__(self) -> str:
        raise KeyboardInterrupt


def raises(x: Any) -> Any:
    raise ValueError(Pressed())


@pytest.mark.parametrize("model", [lambda x: {"y": Pressed()}, raises])
def test_ctrl_c_is_no_fault_of_the_model_that_it_meets(model: Any) -> None:
    study = Study(inputs={"a": {"dist": "normal", "mean": 3.0, "sd": 1.0}}, outputs="y")
    with pytest.raises(KeyboardInterrupt):
        uqsphere.run(study, model)
