"""A measured pulse: a smooth curve of cubics over a record's strain, and the noise that the record leaves on it.

The integrator ends its steps at the joints of the cubics, so that it follows the curve exactly; that the curve is the
record to its noise is the business of whoever fits it.  White noise of standard deviation s in steps of dt moves the
curve by sum_j xi_j phi_j, phi_j = sqrt(2) sin(j pi t/T), xi_j independent normal of standard deviation s sqrt(dt/T):
the first `NOISE_MODES` of them are inputs, the faster ones a contact does not feel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.pulses import Pulse

__all__ = ["NOISE_MODES", "MeasuredPulse", "noise_names"]

Array = npt.NDArray[np.float64]

NOISE_MODES: Final = 6


def noise_names() -> tuple[str, ...]:
    """Inputs of a scene that carry the noise of the record, standard normal each."""
    return tuple(f"pulse.noise_{j}" for j in range(1, NOISE_MODES + 1))


@dataclass(frozen=True, kw_only=True)
class MeasuredPulse:
    """The pulse of a record.

    Attributes
    ----------
    breaks : (m + 1,) tuple
        Joints of the cubics [s], from 0 to the end of the pulse.
    coefficients : (m, 4) tuples
        Strain over its largest value, ascending powers of the time since the joint [1, 1/s, …].
    peak : float
        Largest compressive strain of the curve, above zero; v0 = 2 c0 peak.
    noise : float
        Standard deviation of each noise mode, over the peak.
    rise : float
        Time from 10 % to 90 % of the peak [s].
    source : str
        Name of the file.
    digest : str
        SHA-256 of its bytes.
    notes : tuple of str
        What was done to the record.
    """

    breaks: tuple[float, ...]
    coefficients: tuple[tuple[float, ...], ...]
    peak: float
    noise: float = 0.0
    rise: float
    source: str = ""
    digest: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        joints = np.asarray(self.breaks)
        if len(joints) < 2 or joints[0] != 0.0 or not (np.diff(joints) > 0.0).all():
            raise ValueError("the joints of a measured pulse must ascend from zero")
        if np.shape(self.coefficients) != (len(joints) - 1, 4) or not np.isfinite(self.coefficients).all():
            raise ValueError(f"a measured pulse of {len(joints) - 1} pieces needs as many finite cubics")
        if not self.peak > 0.0 or not self.noise >= 0.0:
            raise ValueError("a measured pulse needs a peak above zero and a noise of zero or more")

    @property
    def duration(self) -> float:
        """End of the pulse [s]."""
        return self.breaks[-1]

    def pulse(self, rows: int, columns: Mapping[str, Array]) -> Pulse:
        """The pieces of n rows, with the noise of `columns` (``pulse.noise_1`` …) where it is given."""
        joints, cubic = np.asarray(self.breaks), np.asarray(self.coefficients)
        pieces = np.broadcast_to(cubic, (rows, *cubic.shape))
        valid = np.ones(rows, dtype=bool)
        if self.noise > 0.0:
            for j, name in enumerate(noise_names(), start=1):
                if name in columns:
                    xi = self.noise * np.asarray(columns[name], dtype=float)
                    pieces = pieces + xi[:, None, None] * _mode(joints, j)
        return Pulse(
            breaks=np.ascontiguousarray(np.broadcast_to(joints, (rows, len(joints)))),
            coefficients=np.ascontiguousarray(pieces), frequency=np.zeros(rows), valid=valid,
        )  # fmt: skip


def _mode(joints: Array, j: int) -> Array:
    """sqrt(2) sin(j pi t/T) as the cubics with its values and slopes at the joints, (m, 4)."""
    rate = j * np.pi / joints[-1]
    value, slope = np.sqrt(2.0) * np.sin(rate * joints), np.sqrt(2.0) * rate * np.cos(rate * joints)
    value[[0, -1]] = 0.0
    h = np.diff(joints)
    rise = np.diff(value) / h
    return np.stack(
        [value[:-1], slope[:-1], (3.0 * rise - 2.0 * slope[:-1] - slope[1:]) / h,
         (slope[:-1] + slope[1:] - 2.0 * rise) / h**2], axis=1,
    )  # fmt: skip
