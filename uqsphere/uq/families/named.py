"""Laws of other packages as families: every continuous law of SciPy by its name, such as `scipy.johnsonsu`.

Their functions are the package's own, and so are their tails: a law is made only where its quantiles and its
probabilities belong to each other far out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.families.family import Family, LawError, Shapes, Standard

PREFIX: Final = "scipy."
#: tail probabilities at which quantiles and probabilities are held against each other: a sample of 1e6 points reaches
#: 1e-7, and what is rarer is looked for by importance sampling
_TAILS: Final = np.array([0.3, 1e-3, 1e-6, 1e-9])
#: what both may differ by, as a share: a tenth of the smallest error that a run can ask of a probability
_AGREE: Final = 1e-4
#: quantiles at 1e-6 and 1e-12 of a tail without variance lie at least this factor apart, 1e6^(1/2), less its start
_HEAVY: Final = 100.0


@dataclass(frozen=True, kw_only=True)
class Functions:
    """What a law of another package is asked: values of any shape, then its shapes; `moments` are mean and variance."""

    cdf: Callable[..., Array]
    sf: Callable[..., Array]
    ppf: Callable[..., Array]
    isf: Callable[..., Array]
    pdf: Callable[..., Array]
    moments: Callable[..., tuple[float, float]]

    def mean_and_variance(self, numbers: Shapes) -> tuple[float, float]:
        """As plain floats, of the law with these shapes."""
        mean, variance = self.moments(*numbers)
        return float(mean), float(variance)

    def tail_order(self, numbers: Shapes, quantile: Callable[..., Array]) -> float:
        """The first moment that a tail does not have, 1 or 2; infinite where both are there."""
        far = np.abs(quantile(np.array([1e-6, 1e-12]), *numbers))
        moments = self.mean_and_variance(numbers) if far[1] > _HEAVY * far[0] else (0.0, 0.0)
        return next((order for order, moment in enumerate(moments, start=1) if not math.isfinite(moment)), math.inf)


def wrapped(name: str, law: Functions, shapes: tuple[str, ...] = ()) -> Family:
    """A family whose functions are those of another package's law, moved by `loc` and stretched by `scale`."""

    def own(function: Callable[..., Array]) -> Standard:
        return lambda values, numbers: np.asarray(function(values, *numbers), dtype=float)

    def canonical(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
        _check_tails(name, law, tuple(given[key] for key in shapes), shapes[0] if shapes else "")
        return given

    def resolve(given: Mapping[str, float], lower: float, upper: float) -> tuple[float, float, Shapes]:
        return given["loc"], given["scale"], tuple(given[key] for key in shapes)

    def no_fit(data: Array, lower: float, upper: float) -> Mapping[str, float]:
        raise ValueError(f"{name} is not fitted to observations")

    return Family(
        name=name,
        label=name,
        alternatives=(shapes,),
        optional={"loc": 0.0, "scale": 1.0},
        dimensional=frozenset({"loc", "scale"}),
        canonical=canonical,
        resolve=resolve,
        cdf=own(law.cdf),
        sf=own(law.sf),
        ppf=own(law.ppf),
        isf=own(law.isf),
        pdf=own(law.pdf),
        mean=lambda numbers: law.mean_and_variance(numbers)[0],
        sd=lambda numbers: math.sqrt(law.mean_and_variance(numbers)[1]),
        heavy_lower=partial(law.tail_order, quantile=law.ppf),
        heavy_upper=partial(law.tail_order, quantile=law.isf),
        fit=no_fit,
    )


def _check_tails(name: str, law: Functions, numbers: Shapes, key: str) -> None:
    """Raise LawError, for a key, where quantiles and probabilities of a tail do not belong to each other."""
    for quantile, share, called in ((law.ppf, law.cdf, "lower"), (law.isf, law.sf, "upper")):
        with np.errstate(all="ignore"):
            places = np.asarray(quantile(_TAILS, *numbers), dtype=float)
            found = np.asarray(share(places, *numbers), dtype=float) / _TAILS
        if np.isnan(places).all():
            raise LawError(f"{name} has no law with these shapes", key)
        wrong = ~(np.abs(found - 1.0) < _AGREE)
        if wrong.any():
            raise LawError(f"the {called} tail of {name} is wrong from the probability {_TAILS[wrong][0]:g} on: "
                           "its quantile there has another probability")  # fmt: skip


@lru_cache(maxsize=64)
def named_family(name: str) -> Family | None:
    """The family of a continuous law of SciPy, by `scipy.NAME`; None where SciPy has none of that name."""
    if not name.startswith(PREFIX):
        return None
    from scipy import stats

    law = getattr(stats, name.removeprefix(PREFIX), None)
    if not isinstance(law, stats.rv_continuous):
        return None
    return wrapped(name, functions_of(law), tuple((law.shapes or "").replace(",", " ").split()))


def functions_of(law: Any) -> Functions:
    """The functions of a continuous law of SciPy."""
    return Functions(cdf=law.cdf, sf=law.sf, ppf=law.ppf, isf=law.isf, pdf=law.pdf,
                     moments=partial(law.stats, moments="mv"))  # fmt: skip
