"""Every declared answer of every rig is there, or refused with a reason, where a user meets it.

Rigs, their tables and numbers, fidelities and quantities are all read from what declares them.
"""

from __future__ import annotations

import math
from typing import get_args

import numpy as np
import pytest

import uqsphere
from uqsphere import Study
from uqsphere.errors import UqsphereError
from uqsphere.mechanics.forms import FORMS, keys_of, needs_of
from uqsphere.mechanics.fracture import path_of
from uqsphere.mechanics.rigs import RIGS
from uqsphere.models.scene import absent_quantity
from uqsphere.quantities import INPUTS, OUTPUTS, lookup
from uqsphere.results.types import Kind
from uqsphere.study import load_study
from uqsphere.study.document import ModelChoice

#: numbers in the middle of their usual ranges need not suit each other
pytestmark = pytest.mark.filterwarnings("ignore:outside the validity range")

FIDELITIES = get_args(ModelChoice.model_fields["fidelity"].annotation)
OF_FRACTURE = [kind for kind in Kind if kind.subject == "fracture"]


def usual(name: str, scatter: bool = False) -> str:
    """A number in the middle of its usual range, as TOML."""
    entry = INPUTS[name]
    low, high = entry.plausible
    middle = math.sqrt(low * high)
    text = f"{middle:.6g}"
    if entry.dimension != "number":
        text = f'"{middle:.6g} {entry.unit}"'
    if scatter:
        text = f'{{ dist = "lognormal", mean = {text}, cov = 0.1 }}'
    return text


def table_of(name: str, keys: list[str]) -> str:
    """A table with usual numbers; the sphere's modulus scatters."""
    rows = [f"{key} = {usual(f'{name}.{key}', (name, key) == ('sphere', 'E'))}" for key in keys]
    return "\n".join([f"[{name}]", *rows, ""])


def study_of(rig: str, law: str, fidelity: str, limits: str = "") -> Study | None:
    """The study of a rig with the first kind of every table; None where it says that the rig does
    not have the fidelity.
    """
    entry = RIGS[rig]
    parts = []
    for table in dict.fromkeys(["sphere", *entry.tables]):
        form = next(iter(FORMS[table].values()))
        keys = [need[0] for need in needs_of(form)]
        if table == entry.ahead:
            keys += keys_of(form.partition(";")[2])
        if table == "sphere" and law == "plastic":
            keys += ["onset_pressure", "hardness"]
        parts.append(table_of(table, keys))
    parts.append("[rig]\n")
    if rig in FORMS["rig"]:
        parts[-1] = table_of("rig", [needs_of(FORMS["rig"][rig])[0][0]])
    parts[-1] += f'kind = "{rig}"\n[contact]\nlaw = "{law}"\n'
    parts.append(f'[model]\nfidelity = "{fidelity}"\ntolerance = 1e-4\n')
    parts.append("[analysis.budget]\nevaluations = 256\n")
    try:
        return load_study(text="".join(parts) + limits)
    except UqsphereError as error:
        if "model.fidelity" in str(error):
            return None
        raise


@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize("law", FORMS["contact"])
@pytest.mark.parametrize("rig", RIGS)
def test_a_quantity_of_a_rig_is_a_number_or_refused_with_a_reason(
    rig: str, law: str, fidelity: str
) -> None:
    study = study_of(rig, law, fidelity)
    if study is None:
        return
    given = []
    for quantity in OUTPUTS:
        reason = absent_quantity(study, quantity)
        if not reason:
            given.append(quantity)
            continue
        with pytest.raises(UqsphereError, match=quantity) as refused:
            uqsphere.evaluate(study, {}, quantities=quantity)
        assert reason in str(refused.value)
    assert np.isfinite(uqsphere.evaluate(study, {}, quantities=given)[given]).all(axis=None)


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize("rig", RIGS)
def test_what_is_told_of_fracture_has_a_number_or_a_reason(
    rig: str, fidelity: str, timed: bool
) -> None:
    """One limit on every quantity of fracture; those of the impact energy have no moment."""
    study = study_of(rig, "hertz", fidelity)
    if study is None:
        return
    names = [
        name
        for name, entry in OUTPUTS.items()
        if entry.fracture and not absent_quantity(study, name) and (path_of(name) or not timed)
    ]
    known = all(map(path_of, names))
    if known and not timed:
        return  # nothing of the impact energy here
    limits = ""
    for name, median in uqsphere.evaluate(study, {}, quantities=names)[names].iloc[0].items():
        strength = f'"{median:.6g} {lookup(str(name)).unit}"'
        limits += f'[limits.{name}]\nquantity = "{name}"\naim = "survive"\n'
        limits += f'strength = {{ dist = "lognormal", mean = {strength}, cov = 0.3 }}\n'
    limited = study_of(rig, "hertz", fidelity, limits)
    assert limited is not None
    results = uqsphere.run(limited).results
    rows = [row for row in results.answers if row.subject == "fracture"]
    assert {row.answer for row in rows} >= set(OF_FRACTURE)
    assert [row.at for row in rows if row.answer == Kind.MODE_SHARE] == names
    assert all(row.note for row in rows if row.value is None)
    absent = {row.answer for row in rows if row.value is None}
    expected = set()
    if not known:
        expected = set(OF_FRACTURE)
    elif RIGS[rig].by_press or (fidelity == "massless" and not RIGS[rig].by_wave):
        expected = {Kind.TIME_AT_FRACTURE}  # peaks in closed form, and no motion
    assert absent == expected
