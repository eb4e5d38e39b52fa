"""The content of sliders.json: what a page needs to answer for other sizes, speeds and stiffnesses without a run."""

from __future__ import annotations

from pydantic import Field, StrictBool, StrictStr

from uqsphere.results.entries import Count, Entry, LawTable, Name, Number


class AxisEntry(Entry):
    """An input of the fitted rows: its value, or the `logarithm` of it, is middle + half · x with x in [-1, 1]."""

    name: Name
    logarithm: StrictBool
    middle: Number
    half: Number


class SliderEntry(Entry):
    """A number that may be moved between `low` and `high` (SI); the study has it at `base`.

    At every one of the `nodes`, ascending values of the number, the rows of the sample have the centre and the spread
    that its law then has: of the logarithm, half the way from the quantile at 16 % to that at 84 %.
    """

    name: Name
    low: Number
    high: Number
    base: Number
    nodes: tuple[Number, ...]
    centres: tuple[Number, ...]
    spreads: tuple[Number, ...]


class SurfaceEntry(Entry):
    """ln of a quantity as the sum of coefficients times products of powers of the inputs' x, in the order of the axes.

    `error` is what 95 % of rows that the fit has not seen keep to, in ln.
    """

    powers: tuple[tuple[Count, ...], ...]
    coefficients: tuple[Number, ...]
    error: Number


class WayEntry(Entry):
    """A way to break with an assumed strength: its laws at the weak end, in the middle and at the strong end.

    `scales`: where a strength hangs on a slider, the logarithm of what it is multiplied by at the slider's nodes.
    """

    quantity: Name
    laws: tuple[LawTable, LawTable, LawTable]
    scales: dict[Name, tuple[Number, ...]] = Field(default_factory=dict)


class Sliders(Entry):
    """Sliders, surfaces by quantity, and assumed ways by their names; where there are none, `reason` says why."""

    reason: StrictStr = ""
    evaluations: Count = 0
    axes: tuple[AxisEntry, ...] = ()
    sliders: tuple[SliderEntry, ...] = ()
    surfaces: dict[Name, SurfaceEntry] = Field(default_factory=dict)
    rough: dict[Name, StrictStr] = Field(default_factory=dict)
    ways: dict[Name, WayEntry] = Field(default_factory=dict)
