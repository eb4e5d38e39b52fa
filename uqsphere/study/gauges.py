"""Where a study puts its strain gauges: [[gauges]], each on a bar at a distance from the sphere."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from uqsphere.quantities import Quantity, format_value
from uqsphere.study.document import GaugeTable
from uqsphere.study.faults import Findings, Place, one_of, shown, suggestion
from uqsphere.study.numbers import read_fixed
from uqsphere.study.scene import Scene
from uqsphere.study.study import Gauge

__all__ = ["GAUGE_BARS", "MOST_GAUGES", "read_gauges"]

GAUGE_BARS: Final = ("incident", "receiving")
MOST_GAUGES: Final = 20
_POSITION: Final = Quantity(name="gauges.position", symbol="d", dimension="length", display="m",
                            meaning="distance of the gauge from the sphere")  # fmt: skip


def read_gauges(tables: Sequence[GaugeTable], scene: Scene, findings: Findings) -> tuple[Gauge, ...]:
    """The gauges of a scene; a bar that is unknown, or too short for its gauge, is noted."""
    if len(tables) > MOST_GAUGES:
        findings.add(("gauges",), f"found {len(tables)} gauges, at most {MOST_GAUGES} are allowed")
        return ()
    found: list[Gauge] = []
    for index, table in enumerate(tables):
        place: Place = ("gauges", index)
        bar = _read_bar(table, place, findings)
        position = _read_position(table, place, findings)
        if bar is None or position is None:
            continue
        length = scene.mean(f"bars.{bar}_length")
        if length is not None and position > length:
            findings.add(
                (*place, "position"),
                f"found {shown(table.position)}, beyond the far end of the {bar} bar of "
                f"{format_value(length, f'bars.{bar}_length')}: the distance counts from the sphere",
            )
            continue
        gauge = Gauge(bar=bar, position=position)
        if gauge in found:
            findings.add(place, f"a gauge on the {bar} bar at this place is named twice")
            continue
        found.append(gauge)
    return tuple(found)


def _read_bar(table: GaugeTable, place: Place, findings: Findings) -> str | None:
    if table.bar in GAUGE_BARS:
        return str(table.bar)
    if table.bar is not None:
        near = suggestion(table.bar, GAUGE_BARS) if isinstance(table.bar, str) else ""
        findings.add((*place, "bar"), f"found {shown(table.bar)}, allowed: {one_of(GAUGE_BARS)}{near}")
    elif findings.clean(place):
        findings.add(place, f'bar is missing ({one_of(GAUGE_BARS)}): add bar = "incident"')
    return None


def _read_position(table: GaugeTable, place: Place, findings: Findings) -> float | None:
    if table.position is not None:
        return read_fixed(table.position, (*place, "position"), _POSITION, findings)
    if findings.clean((*place, "position")) and findings.clean(place):
        findings.add(place, 'position is missing (distance from the sphere): add position = "0.75 m"')
    return None
