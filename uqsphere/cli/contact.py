"""`uqsphere fit-contact`: the law of a contact that yields, from a slow test on a sphere between two platens."""

from __future__ import annotations

import argparse
import math
import sys
from typing import TYPE_CHECKING

from uqsphere.cli.records import columns_named, ends, number_row, reading, three
from uqsphere.cli.studies import number_of
from uqsphere.console import answer, plain, table
from uqsphere.errors import UsageError

if TYPE_CHECKING:
    from uqsphere.records.loading import ContactFit


def command_fit_contact(chosen: argparse.Namespace) -> int:
    """Onset, hardness and pile-up of a slow test, as the lines of a study."""
    from uqsphere.materials import library
    from uqsphere.mechanics.yielding import metal_onset
    from uqsphere.records.loading import fit_contact, read_loading

    diameter = number_of(chosen.diameter, "length", "--diameter", above=0.0)
    machine = chosen.machine_stiffness
    stiffness = math.inf if machine is None else number_of(machine, "stiffness", "--machine-stiffness", above=0.0)
    if not 0.0 <= chosen.nu < 0.5:
        raise UsageError(f"--nu {chosen.nu:g}: it lies from 0 to below 0.5")
    if chosen.pile_up is not None and not 1.0 <= chosen.pile_up <= 3.0:
        raise UsageError(f"--pile-up {chosen.pile_up:g}: it lies from 1 to 3")
    known = {**library()["bars"], **library()["plates"]}
    if chosen.platens != "rigid" and chosen.platens not in known:
        raise UsageError(f"--platens: found {chosen.platens!r}, allowed: rigid, {', '.join(known)}")
    with reading(chosen.record):
        units = (chosen.displacement_unit, chosen.force_unit)
        loading = read_loading(chosen.record, columns=columns_named(chosen), units=units)
        fit = fit_contact(loading, diameter=diameter, compliance=1.0 / stiffness, pile_up=chosen.pile_up)
    notes, soft = list(loading.notes), 0.0
    if chosen.platens != "rigid":
        bar = {key: entry.value for key, entry in known[chosen.platens].properties.items()}
        soft = (1.0 - bar["nu"] ** 2) / bar["E"]
        onset = float(metal_onset(bar.get("yield_strength", math.inf), bar["nu"]))
        if fit.onset.high > onset / 1.3:
            notes.append(f"the platens yield from {onset / 1e9:.3g} GPa on: what was fitted may be theirs")
    return _answer_fit(chosen, fit, soft, notes)


def _answer_fit(chosen: argparse.Namespace, fit: ContactFit, soft: float, notes: list[str]) -> int:
    """The numbers of a fit with their intervals; `soft` [1/Pa] is what the platens add to the compliance."""
    named = {"onset_pressure": fit.onset, "hardness": fit.hardness, "pile_up": fit.pile_up}
    rest = [1.0 / number - soft for number in three(fit.modulus)]
    young = [(1.0 - chosen.nu**2) / number for number in rest] if min(rest) > 0.0 else None
    document = {
        "kind": "contact", "file": chosen.record.name, **{name: ends(three(part)) for name, part in named.items()},
        "reduced_modulus": ends(three(fit.modulus)), "sphere_modulus": None if young is None else ends(young),
        "depth": fit.depth, "dent": fit.dent, "misfit": fit.misfit, "samples": fit.samples, "notes": notes,
    }  # fmt: skip
    if chosen.pile_up is None and fit.hardness.high - fit.hardness.low > fit.hardness.value:
        notes.append("the test hardly tells hardness from pile-up: --pile-up narrows the hardness (2 where a sphere "
                     "crushes, 2.667 where a metal flows)")  # fmt: skip
    if not chosen.json:
        print("".join(f"note: {plain(note)}\n" for note in notes), end="", file=sys.stderr)
    rows = [
        number_row("onset pressure", "GPa", 1e-9, three(fit.onset)),
        number_row("hardness", "GPa", 1e-9, three(fit.hardness)),
        number_row("pile-up", "", 1.0, three(fit.pile_up)),
        number_row("reduced modulus E*", "GPa", 1e-9, three(fit.modulus)),
        *([] if young is None else [number_row("E of the sphere that gives it", "GPa", 1e-9, young)]),
        ("pressed to, over first yield", f"{fit.depth:.3g}", ""), ("dent", f"{1e6 * fit.dent:.3g} um", ""),
        ("misfit of the displacement", f"{1e6 * fit.misfit:.2g} um", f"{fit.samples} samples"),
    ]  # fmt: skip
    lines = ["", "[contact]", 'law = "plastic"', f'onset_pressure = "{fit.onset.value / 1e9:.4g} GPa"',
             f'hardness = "{fit.hardness.value / 1e9:.4g} GPa"', f"pile_up = {fit.pile_up.value:.4g}"]  # fmt: skip
    return answer(chosen, document, "\n".join([table(("what", "value", "95 % interval"), rows), *lines]))
