"""Whether the numbers of a scene go together; each check needs only the numbers that it names."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from uqsphere.mechanics.pulses import striker_steps
from uqsphere.quantities import format_value
from uqsphere.study.faults import Findings
from uqsphere.study.scene import Scene
from uqsphere.study.study import ModelChoice
from uqsphere.uq.law import Law

__all__ = ["check_scene"]

#: Two lengths that are meant to be equal differ by rounding alone.
_ROUNDING: Final = 1.0 + 1e-9


def check_scene(scene: Scene, model: ModelChoice | None, findings: Findings) -> None:
    """Note every contradiction between the numbers of the scene, the random ones taken at their nominal "
    "mean."""
    for check in _CHECKS:
        check(scene, findings)
    _check_step(scene, model, findings)


def pulse_duration(scene: Scene) -> float | None:
    """t_i [s]: the pulse's own duration, or 2 l_0/c_0 of the striker; infinite for a step."""
    if scene.options.get("pulse.shape") == "step":
        return math.inf
    if scene.record is not None:
        return scene.record.duration
    if (own := scene.mean("pulse.duration")) is not None:
        return own
    length, speed = scene.mean("striker.length"), _wave_speed(scene, "striker")
    return None if length is None or speed is None else 2.0 * length / speed


def striker_ratio(scene: Scene) -> float | None:
    """Impedance of the striker over that of the bars; None where it is a piece of the bars, or a number is missing."""
    if all(f"striker.{key}" not in scene.readings for key in ("E", "density", "diameter")):
        return None
    product = 1.0
    for key, power in (("E", 0.5), ("density", 0.5), ("diameter", 2.0)):
        bars = scene.mean(f"bars.{key}")
        own = scene.mean(f"striker.{key}") if f"striker.{key}" in scene.readings else bars
        if own is None or bars is None:
            return None
        product *= (own / bars) ** power
    return product


def _wave_speed(scene: Scene, part: str = "bars") -> float | None:
    def own(key: str) -> float | None:
        return scene.mean(f"{part}.{key}") if f"{part}.{key}" in scene.readings else scene.mean(f"bars.{key}")

    stiffness, density = own("E"), own("density")
    return None if stiffness is None or density is None else math.sqrt(stiffness / density)


def _check_size(scene: Scene, findings: Findings) -> None:
    radius, diameter = scene.mean("sphere.radius"), scene.mean("bars.diameter")
    if radius is not None and diameter is not None and 2.0 * radius > diameter * _ROUNDING:
        findings.add(
            ("sphere", "radius"),
            f"the sphere, 2 x {format_value(radius, 'sphere.radius')} across, is larger than its bars of "
            f"{format_value(diameter, 'bars.diameter')}: take a smaller sphere or thicker bars",
        )


def _check_trapezoid(scene: Scene, findings: Findings) -> None:
    rise, fall, width = scene.mean("pulse.rise"), scene.mean("pulse.fall"), pulse_duration(scene)
    if scene.options.get("pulse.shape") == "ramp":
        fall = 0.0
    if scene.options.get("pulse.shape") not in ("trapezoid", "ramp") or rise is None or fall is None or width is None:
        return
    if 0.5 * (rise + fall) > width * _ROUNDING:
        findings.add(
            ("pulse", "rise"),
            f"half of rise and fall, {format_value(0.5 * (rise + fall), 'pulse.rise')}, exceeds the width "
            "of the pulse, "
            f"{format_value(width, 'pulse.duration')}: shorten them, or lengthen the striker",
        )


def _check_two_peak(scene: Scene, findings: Findings) -> None:
    first, second, end = scene.mean("pulse.t1"), scene.mean("pulse.t2"), pulse_duration(scene)
    if scene.options.get("pulse.shape") != "two_peak" or first is None or second is None:
        return
    if first >= second:
        findings.add(
            ("pulse", "t2"),
            f"found t1 = {format_value(first, 'pulse.t1')} and t2 = {format_value(second, 'pulse.t2')}: "
            "the first peak must come before the second",
        )
    elif end is not None and second >= end:
        findings.add(
            ("pulse", "t2"),
            f"the second peak, at {format_value(second, 'pulse.t2')}, must come before the end of the pulse "
            "at "
            f"{format_value(end, 'pulse.duration')}: give a longer duration",
        )


def _open_ended(scene: Scene) -> bool:
    """Whether nothing returns from the far end of the incident bar."""
    end = scene.readings.get("bars.incident_end")
    absorbing = end is not None and not isinstance(end.value, Law) and end.value == 0.0
    return scene.options.get("bars.infinite") is True or absorbing or end is None


def _check_round_trip(scene: Scene, findings: Findings) -> None:
    width, length, speed = pulse_duration(scene), scene.mean("bars.incident_length"), _wave_speed(scene)
    if width is None or length is None or speed is None or math.isinf(width) or _open_ended(scene):
        return
    if not findings.clean(("pulse",)):
        return
    ratio = striker_ratio(scene)
    if ratio is not None:
        levels, complete = striker_steps(ratio)
        if not complete[0]:
            found = f"the striker's impedance is {ratio:.3g} times that of the bars, at most 9 is allowed"
            findings.add(("striker",), f"{found}: take a thinner or lighter striker")
            return
        width *= levels.shape[1]
    if scene.options.get("pulse.shape") in ("trapezoid", "ramp"):
        width += 0.5 * ((scene.mean("pulse.rise") or 0.0) + (scene.mean("pulse.fall") or 0.0))
    trip = 2.0 * length / speed
    if width > trip * _ROUNDING:
        place = ("pulse", "duration") if "pulse.duration" in scene.readings else ("striker", "length")
        place = place if scene.record is None else ("pulse", "file")
        findings.add(
            place,
            f"the whole pulse lasts {format_value(width, 'pulse.duration')}, longer than the round trip of "
            f"{format_value(trip, 'pulse.duration')} in the incident bar, whose far end cannot reflect "
            "before the "
            'striker has left it: shorten the pulse, lengthen the bar, or set incident_end = "absorbing"',
        )


def _check_step(scene: Scene, model: ModelChoice | None, findings: Findings) -> None:
    if scene.options.get("pulse.shape") != "step":
        return
    if model is not None and model.horizon is None and findings.clean(("model", "horizon")):
        findings.add(
            ("model", "horizon"),
            'a step pulse never ends, so that the record needs an end: add horizon = "3 ms" to [model]',
        )
    if not _open_ended(scene) and "bars.incident_length" in scene.readings:
        findings.add(
            ("pulse", "shape"),
            "a step pulse is longer than any round trip of the incident bar: set bars.infinite = true or "
            'incident_end = "absorbing"',
        )


_CHECKS: Final[tuple[Callable[[Scene, Findings], None], ...]] = (
    _check_size,
    _check_trapezoid,
    _check_two_peak,
    _check_round_trip,
)
