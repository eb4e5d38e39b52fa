"""The far end of the receiving bar as an impedance against frequency: a CSV beside the study."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Final

from uqsphere.study.columns import read_column
from uqsphere.study.document import BarsTable
from uqsphere.study.faults import Findings, Place, shown
from uqsphere.study.numbers import plain_quantity
from uqsphere.study.study import EndImpedance

__all__ = ["DAMPER_COLUMNS", "read_damper"]

#: frequency [Hz], impedance [kg/s] with the time factor exp(+i 2 pi f t)
DAMPER_COLUMNS: Final = ("frequency", "impedance_real", "impedance_imag")
_PLACE: Place = ("bars", "receiving_damper")


def read_damper(bars: BarsTable | None, findings: Findings, folder: Path) -> EndImpedance | None:
    """The damper of a study, if it has one; what is missing or cannot be is noted."""
    name = None if bars is None else bars.receiving_damper
    if bars is None or name is None:
        return None
    if not isinstance(name, str) or not name:
        findings.add(_PLACE, f'found {shown(name)}, where the name of a CSV is due, such as "damper.csv"')
        return None
    if bars.infinite:
        findings.add(_PLACE, "infinite bars have no far end: leave infinite or receiving_damper out")
        return None
    if bars.receiving_end is not None:
        findings.add(_PLACE, "the far end is given twice: leave receiving_end or receiving_damper out")
        return None
    columns = []
    for column in DAMPER_COLUMNS:
        values = read_column({"file": name, "column": column}, _PLACE, plain_quantity(column), findings, folder)
        if not values:
            return None
        columns.append(values)
    frequency, real, imaginary = columns
    if frequency[0] <= 0.0 or any(after <= before for before, after in pairwise(frequency)):
        findings.add(_PLACE, f"the frequencies in {shown(name)} must be positive and ascend")
        return None
    if min(real) < 0.0:
        findings.add(
            _PLACE, f"found {min(real):g} in impedance_real of {shown(name)}: below 0 the end would feed the bar"
        )
        return None
    findings.warn(_PLACE, "followed by history alone; a run takes a number: receiving_end in place of receiving_damper")
    return EndImpedance(frequency=frequency, real=real, imaginary=imaginary)
