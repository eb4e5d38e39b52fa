"""The free scalar of an inverse question: where it may lie, and what of a study it moves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics.bars import section
from uqsphere.mechanics.contact import sphere_mass
from uqsphere.quantities import INPUTS
from uqsphere.uq import Law

if TYPE_CHECKING:
    from uqsphere.study.study import Limit, Study


#: More than this share of a law outside what has a meaning is worth a word.
SHARE_WORTH_A_WORD: Final = 1e-6
#: kinetic energy of the striker over the mass of the sphere: a free scalar that is no number of the file
ENERGY: Final = "striker.specific_energy"
SPEED: Final = "striker.speed"
_LIMITS, _STRENGTH = "limits.", ".strength"


@dataclass(frozen=True, kw_only=True)
class Axis:
    """A scalar that is free between two values (SI).

    `kind`: a "number" of the scene or of the model's inputs (the mean of its law, where it scatters), the "energy" of
    the striker over the mass of each row's sphere, or the mean "strength" of a limit, all its values in proportion.
    """

    path: str
    low: float
    high: float
    kind: Literal["number", "energy", "strength"] = "number"

    @property
    def limit(self) -> str | None:
        """The limit whose strength is free."""
        return limit_of(self.path) if self.kind == "strength" else None

    @property
    def moves_rows(self) -> bool:
        """Whether the answers of the model depend on the scalar; else the rows of one value serve all."""
        return self.kind != "strength"

    @property
    def logarithmic(self) -> bool:
        """Whether the scalar is positive, so that it is taken in ratios."""
        return self.low > 0.0

    def grid(self, count: int) -> list[float]:
        """`count` values from one end to the other, in equal ratios or steps."""
        return spaced(self.low, self.high, count)

    def value(self, share: Array | float) -> Array:
        """The value a share of the way from one end to the other, in ratios or steps."""
        if self.logarithmic:
            return np.asarray(self.low * (self.high / self.low) ** share)
        return np.asarray(self.low + (self.high - self.low) * share)

    def germ(self, value: float) -> float:
        """The place of a value as a number in [-1, 1], the inverse of `value`."""
        low, high = self.low, self.high
        if self.logarithmic:
            low, high, value = math.log(low), math.log(high), math.log(value)
        return 2.0 * (value - low) / (high - low) - 1.0

    def move(self, study: Study, value: float) -> Study:
        """The study whose rows are drawn where the scalar has a value: itself, unless the scalar is one of its numbers.

        Raises LawError where a random number has no law with this mean.
        """
        return with_number(study, self.path, value) if self.kind == "number" else study

    def place(self, study: Study, physical: Array, value: float) -> tuple[tuple[str, ...], Array]:
        """Names and values (R, n, d) of the random inputs, drawn from the moved study, where the scalar has a value.

        An energy is imposed on every row by its own speed, which keeps its ratio to its mean where it scatters.
        """
        names = tuple(study.random)
        if self.kind != "energy":
            return names, physical
        speed = _speed_at_energy(study, physical, value)
        if SPEED not in names:
            return (*names, SPEED), np.concatenate([physical, speed[:, :, None]], axis=2)
        physical = physical.copy()
        physical[:, :, names.index(SPEED)] = speed
        return names, physical

    def demand_factor(self, limit: Limit, value: float) -> float:
        """What the demands of a limit are multiplied by where the scalar has a value, in place of its free strength."""
        if self.limit != limit.name:
            return 1.0
        nominal = limit.strength.nominal_mean() if isinstance(limit.strength, Law) else limit.strength
        return nominal / value

    def fix(self, study: Study, limit: Limit, value: float) -> tuple[Study, Limit] | str:
        """The study and a limit with the scalar at a value, an energy as that of the mean scene; or why there is none.

        Raises LawError as `move`.
        """
        if self.kind == "strength":
            if self.limit == limit.name and isinstance(limit.model_factor, Law):
                return "the strength is the free number and the model factor is random"
            if self.limit == limit.name and not isinstance(limit.model_factor, Law):
                limit = replace(limit, model_factor=limit.model_factor * self.demand_factor(limit, value))
            return study, limit
        if self.kind == "number":
            return self.move(study, value), limit
        if SPEED in study.random and "mean" not in study.given[SPEED]:
            return "the speed scatters by a law that is not given by its mean"
        means = study.at_means()
        return with_number(
            study, SPEED, float(np.sqrt(2.0 * value * _sphere_mass(means) / _striker_mass(means)))
        ), limit


def make_axis(path: str, low: float, high: float, *, limits: Mapping[str, str], black_box: bool) -> Axis:
    """The axis of a path; `limits` has the quantities of the limits by the paths of their strengths."""
    if path in limits:
        return Axis(path=path, low=low, high=high, kind="strength")
    return Axis(path=path, low=low, high=high, kind="energy" if path == ENERGY and not black_box else "number")


# --- paths of the random variables of limits -----------------------------------------------------------


def strength_name(limit: str) -> str:
    """The path of a limit's strength."""
    return f"{_LIMITS}{limit}{_STRENGTH}"


def limit_of(path: str) -> str | None:
    """The limit that a strength or a model factor belongs to; None for a number of the scene.

    >>> limit_of("limits.crushing.strength"), limit_of("striker.speed")
    ('crushing', None)
    """
    return path.removeprefix(_LIMITS).rpartition(".")[0] if path.startswith(_LIMITS) else None


def quantity_of(path: str, limits: Mapping[str, str]) -> str:
    """The name whose unit a number has: a strength that of its limit's quantity, by the limits' names.

    >>> quantity_of("limits.crushing.strength", {"crushing": "p_max"}), quantity_of("striker.speed", {})
    ('p_max', 'striker.speed')
    """
    return limits.get(limit_of(path) or "", path) if path.endswith(_STRENGTH) else path


# --- moving ------------------------------------------------------------------------------------------------


def spaced(low: float, high: float, count: int) -> list[float]:
    """`count` values from low to high in equal ratios, or in equal steps where they are not positive."""
    inner = np.geomspace(low, high, count) if low > 0.0 else np.linspace(low, high, count)
    return [low, *(float(value) for value in inner[1:-1]), high]


def with_number(study: Study, path: str, value: float) -> Study:
    """The study with a number at `value`: the mean of its law, or the number itself."""
    if path in study.random:
        moved = _kept_inside(study.random[path].with_mean(value, study.given[path]), path)
        return replace(study, random={**study.random, path: moved})
    return replace(study, fixed={**study.fixed, path: value})


def _kept_inside(law: Law, path: str) -> Law:
    """A moved law, cut where its number has no meaning if a share of it that counts has come to lie there.

    A height of 12 mm with a standard deviation of 0.5 mm is never negative; one of 0.2 mm with the same often would be.
    """
    quantity = INPUTS.get(path)
    if quantity is None:
        return law
    low = np.array([quantity.lower])
    if law.lower < quantity.lower and float(law.cdf(low)[0]) > SHARE_WORTH_A_WORD:
        law = replace(law, lower=quantity.lower)
    return law


def _sphere_mass(of: Mapping[str, float] | Mapping[str, Array]) -> Array:
    return np.asarray(sphere_mass(of["sphere.radius"], of["sphere.density"]))


def _striker_mass(of: Mapping[str, float] | Mapping[str, Array]) -> Array:
    return np.asarray(of["bars.density"] * section(of["bars.diameter"]) * of["striker.length"])


def _speed_at_energy(study: Study, physical: Array, energy: float) -> Array:
    """Speeds (R, n) at which the striker's kinetic energy is `energy` times the mass of each row's sphere."""
    names = tuple(study.random)
    columns = {name: np.full(physical.shape[:2], value) for name, value in study.fixed.items()}
    columns |= {name: np.asarray(physical[:, :, k]) for k, name in enumerate(names)}
    speed = np.sqrt(2.0 * energy * _sphere_mass(columns) / _striker_mass(columns))
    if SPEED in study.random:
        speed = speed * columns[SPEED] / study.random[SPEED].nominal_mean()
    return np.asarray(speed)
