"""A study while it is read: its tables, and the numbers that are understood so far."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uqsphere.mechanics.outputs import OUTPUTS
from uqsphere.mechanics.pulses import MeasuredPulse
from uqsphere.study.document import Document
from uqsphere.study.fault import Place, path_of
from uqsphere.study.number import Number
from uqsphere.uq import Law

if TYPE_CHECKING:
    from uqsphere.study.study import Limit, Margins, Source


@dataclass(kw_only=True)
class Draft:
    """What is understood of a study.

    folder : that of the study, outside of which no file is read; files: those it has read, by the names it gives them.
    data : the tables as the file has them; document: the same, validated.
    numbers : by dotted path (black box: bare name) in the order of the file, strengths and model factors last.
    """

    folder: Path = Path()
    data: dict[str, Any] = field(default_factory=dict)
    document: Document = field(default_factory=Document.model_construct)
    numbers: dict[str, Number] = field(default_factory=dict)
    options: dict[str, str | bool | int] = field(default_factory=dict)
    materials: dict[str, str] = field(default_factory=dict)
    sources: dict[str, Source] = field(default_factory=dict)
    record: MeasuredPulse | None = None
    limits: dict[str, Limit] = field(default_factory=dict)
    margins: Margins | None = None
    warnings: list[str] = field(default_factory=list)
    files: dict[str, Path] = field(default_factory=dict)

    def warn(self, place: Place, message: str) -> None:
        """Note what a user should know and what does not stop the study, once."""
        text = f"{path_of(place)}: {message}" if place else message
        if text not in self.warnings:
            self.warnings.append(text)

    def mean(self, path: str, absent: float = math.nan) -> float:
        """A number at its nominal mean; NaN, for which no comparison holds, where there is none."""
        return self.numbers[path].mean if path in self.numbers else absent

    def elastic(self, table: str) -> tuple[float, float]:
        """E [Pa] and nu at their means of what touches the sphere: an insert, or the body of a table."""
        E, nu = (self.mean(f"{table}.insert_{key}", self.mean(f"{table}.{key}")) for key in ("E", "nu"))
        return E, nu

    @property
    def box(self) -> bool:
        """Whether the study is a black box."""
        return "inputs" in self.data or "outputs" in self.data

    @property
    def rig(self) -> str:
        """What loads the sphere."""
        return str(self.document.rig.kind)

    @property
    def plastic(self) -> bool:
        """Whether contacts can yield."""
        return self.document.contact.law == "plastic"

    @property
    def known(self) -> list[str]:
        """The quantities that can be asked for."""
        return list(self.document.outputs.names if self.box else OUTPUTS)

    @property
    def random(self) -> dict[str, Number]:
        """The numbers that scatter: inputs in the order of the file, then strengths and model factors."""
        return {name: number for name, number in self.numbers.items() if isinstance(number.value, Law)}
