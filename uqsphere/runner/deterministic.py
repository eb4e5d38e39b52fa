"""One scene over time: what `uqsphere history` prints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from uqsphere.errors import UsageError
from uqsphere.model import scene_of
from uqsphere.quantities import format_value
from uqsphere.study import Study

if TYPE_CHECKING:
    from uqsphere.mechanics.history import History

__all__ = ["history_of", "history_summary"]


def history_of(study: Study, values: Mapping[str, float] | None = None, *, points: int = 2000) -> History:
    """The course of one scene: every number at its mean, or as `values` (dotted path -> SI) give it.

    Raises
    ------
    UsageError
        For a scene outside the model's domain, or a number that a scene does not have.
    """
    from uqsphere.mechanics.history import trace
    from uqsphere.mechanics.scene import STATUS

    if study.black_box:
        raise UsageError("history shows an impact scene; this study is a black box")
    scene = scene_of(study, {name: np.array([float(value)]) for name, value in (values or {}).items()}, 1)
    status = int(scene.status[0])
    if status:
        raise UsageError(f"this scene cannot be computed: {STATUS[status]}")
    fidelity = "full" if study.model.fidelity == "auto" else study.model.fidelity
    return trace(scene, 0, fidelity=fidelity, tolerance=min(study.model.tolerance, 1e-8), points=points)


def history_summary(found: History) -> dict[str, Any]:
    """The findings of a history as (what, value) lines, for the terminal and for JSON."""
    lines = [("mu (mass of the sphere)", f"{found.mass_number:.4g}")]
    lines.append(("theta (length of the pulse)", f"{found.pulse_number:.4g}"))
    if found.first_peak is not None:
        peak = found.first_peak
        lines.append(("largest contact pressure before contact is lost", format_value(peak.pressure, "p_max", 6)))
        lines.append(("  at", f"{peak.time * 1e6:.4g} us, face {peak.face}"))
        lines.append(("  force there", format_value(peak.force, "P_max", 6)))
    for change in found.changes:
        word = "lost" if change.kind == "lost" else "found again"
        lines.append((f"contact {word} at face {change.face}", f"{change.time * 1e6:.6g} us"))
    if found.later_peak is not None:
        peak = found.later_peak
        lines.append(("largest contact pressure afterwards", format_value(peak.pressure, "p_max", 6)))
        lines.append(("  at", f"{peak.time * 1e6:.4g} us, face {peak.face}"))
    if found.later_peak_is_larger:
        lines.append(
            ("NOTE", "the later peak is the larger one: quantities of interest end at the first loss of contact")
        )
    lines.append(("end of the record of the quantities", f"{found.record_end * 1e6:.6g} us"))
    lines.append(("end of this history", f"{found.horizon * 1e6:.6g} us"))
    return {
        "mu": found.mass_number,
        "theta": found.pulse_number if np.isfinite(found.pulse_number) else None,
        "record_end": found.record_end,
        "later_peak_is_larger": found.later_peak_is_larger,
        "lines": [list(line) for line in lines],
    }
