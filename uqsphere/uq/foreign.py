"""Laws of SciPy and chaospy as laws of this package: of a family of its own where there is one, wrapped else.

Neither package is imported here: what is given tells where it is from.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.families import LawError
from uqsphere.uq.families.family import PREFIX, named_family, wrapped
from uqsphere.uq.joint import Dependence, Joint, make_joint
from uqsphere.uq.law import Law, checked, make_law

if TYPE_CHECKING:
    from chaospy import Distribution

#: a law, its table as in a study, or a distribution of scipy.stats or chaospy
LawLike: TypeAlias = Any
#: the keys of a law in a study: `dist`, parameters and bounds
Table: TypeAlias = dict[str, str | float]

#: probabilities at which a law is compared with what it was made from, and what both may differ by, over the scatter:
#: chaospy iterates some of its quantiles to 1e-8
_PLACES: Final = np.array([1e-4, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0 - 1e-4])
_SAME: Final = 1e-6


#: families of this package by SciPy's names, from shapes, loc and scale; None where loc has no place there
_TABLES: Final[Mapping[str, Callable[..., Table | None]]] = {
    "norm": lambda loc, scale: {"dist": "normal", "mean": loc, "sd": scale},
    "lognorm": lambda s, loc, scale: None if loc else {"dist": "lognormal", "log_mean": math.log(scale), "log_sd": s},
    "uniform": lambda loc, scale: {"dist": "uniform", "lower": loc, "upper": loc + scale},
    "loguniform": lambda a, b, loc, scale: None if loc else {"dist": "loguniform", "lower": scale * a,
                                                            "upper": scale * b},
    "triang": lambda c, loc, scale: {"dist": "triangular", "mode": loc + c * scale, "lower": loc, "upper": loc + scale},
    "beta": lambda a, b, loc, scale: {"dist": "beta", "lower": loc, "upper": loc + scale, "alpha": a, "beta": b},
    "gamma": lambda a, loc, scale: None if loc else {"dist": "gamma", "shape": a, "scale": scale},
    "weibull_min": lambda c, loc, scale: {"dist": "weibull", "modulus": c, "scale": scale, "threshold": loc},
    "gumbel_r": lambda loc, scale: {"dist": "gumbel", "location": loc, "scale": scale},
    "invweibull": lambda c, loc, scale: {"dist": "frechet", "shape": c, "scale": scale, "location": loc},
    "expon": lambda loc, scale: None if loc else {"dist": "exponential", "rate": 1.0 / scale},
    "rayleigh": lambda loc, scale: None if loc else {"dist": "rayleigh", "scale": scale},
    "t": lambda df, loc, scale: {"dist": "student_t", "dof": df, "location": loc, "scale": scale},
    "truncnorm": lambda a, b, loc, scale: {
        "dist": "normal", "mean": loc, "sd": scale,
        **{key: loc + scale * end for key, end in (("lower", a), ("upper", b)) if math.isfinite(end)},
    },
}  # fmt: skip

#: chaospy's laws in standard form, by their classes, as SciPy has them: name, then shapes, loc and scale
_CHAOSPY: Final[Mapping[str, Callable[..., tuple[str | float, ...]]]] = {
    "normal": lambda: ("norm", 0.0, 1.0),
    "uniform": lambda: ("uniform", -1.0, 2.0),
    "log_normal": lambda a: ("lognorm", a, 0.0, 1.0),
    "log_uniform": lambda lo, up: ("loguniform", math.exp(lo), math.exp(up), 0.0, 1.0),
    "gamma": lambda a: ("gamma", a, 0.0, 1.0),
    "weibull": lambda a: ("weibull_min", a, 0.0, 1.0),
    "student_t": lambda a: ("t", a, 0.0, 1.0),
    "triangle": lambda a: ("triang", a, 0.0, 1.0),
    "cauchy": lambda: ("cauchy", 0.0, 1.0),
    "laplace": lambda: ("laplace", 0.0, 1.0),
    "logistic": lambda c: ("genlogistic", c, 0.0, 1.0),
    "beta_": lambda a, b: ("beta", a, b, 0.0, 1.0),
    "trunc_normal": lambda a, b, mu, sigma: ("truncnorm", (a - mu) / sigma, (b - mu) / sigma, mu, sigma),
}


def law_table(given: LawLike) -> Table:
    """The table by which a study file has a law: that of a distribution of SciPy or chaospy, or of a law.

    Raises
    ------
    LawError
        For what is no such distribution, or has no table: observations, and laws of chaospy that SciPy does not have.
    """
    if isinstance(given, Mapping):
        return dict(given)
    if isinstance(given, Law):
        if given.data or given.draws or given.family.name == "chaospy":
            raise LawError("a law of observations, or one that is wrapped, has no table: give it to the analyses")
        ends = {"lower": given.lower, "upper": given.upper}
        bounds = {key: end for key, end in ends.items() if math.isfinite(end)}
        return {"dist": given.family.name, **given.parameters, **bounds}
    return law_table(as_law(given))


def as_law(given: LawLike) -> Law:
    """A law from a law, its table (`{"dist": "normal", "mean": 0, "sd": 1}`), or of scipy.stats or chaospy.

    A distribution is taken by its own parameters, so that both tails are those of this package, and its quantiles are
    compared with those of what was given.  One that has no family here keeps its functions.

    Raises
    ------
    LawError
        For anything else, several numbers at once, discrete laws, and laws whose tails contradict themselves.

    >>> from scipy import stats
    >>> law = as_law(stats.norm(1.0, 0.1))
    >>> law.family.name, float(law.isf(np.array([1e-30]))[0].round(9))
    ('normal', 2.146402469)
    """
    if isinstance(given, Law):
        return given
    if isinstance(given, Mapping):
        rest = {key: float(value) for key, value in given.items() if key != "dist"}
        bounds = rest.pop("lower", None), rest.pop("upper", None)
        return make_law(str(given.get("dist")), rest, *bounds)
    origin = type(given).__module__.partition(".")[0]
    if origin == "scipy" and hasattr(given, "dist") and hasattr(given, "kwds"):
        if not hasattr(given.dist, "pdf"):
            raise LawError(f"{given.dist.name} of SciPy is discrete: expansions and tails need a density")
        shapes, loc, scale = given.dist._parse_args(*given.args, **given.kwds)
        return _compared(_of_scipy(given.dist.name, *shapes, loc, scale), given.ppf)
    if origin == "chaospy" and hasattr(given, "inv") and hasattr(given, "pdf"):
        if len(given) != 1:
            raise LawError("a distribution of chaospy of several numbers: give each its own, and their dependence")
        return _of_chaospy(given)
    raise LawError(f"found {type(given).__name__}: a law, its table, or a frozen distribution of scipy.stats or "
                   "chaospy is due")  # fmt: skip


def _of_scipy(name: str, *given: float) -> Law:
    """The law by its name, shapes, loc and scale in SciPy."""
    numbers = [float(np.asarray(value)) for value in given]
    made = _TABLES.get({"reciprocal": "loguniform"}.get(name, name))
    table = None if made is None else made(*numbers)
    if table is None:
        family = named_family(PREFIX + name)
        if family is None:
            raise LawError(f"scipy.stats has no law {name!r} by this name: a law of one's own has no place in a study")
        table = {"dist": family.name} | dict(zip((*family.alternatives[0], "loc", "scale"), numbers, strict=True))
    return as_law(table)


def _compared(law: Law, quantile: Callable[[Array], Array], same: float = _SAME) -> Law:
    """The law, once its quantiles are those of what it was made from."""
    ours, theirs = law.ppf(_PLACES), np.asarray(quantile(_PLACES), dtype=float).ravel()
    if not np.abs(ours - theirs).max() <= same * np.ptp(ours):
        raise LawError(f"{law.family.name} with the same parameters has other quantiles: give the law by its table")
    return law


def _of_chaospy(given: Distribution) -> Law:
    """The law of chaospy by its parameters where these are known here, else by its functions."""
    law = _unrolled(given)
    if law is not None:
        return _compared(law, given.inv)
    family = wrapped("chaospy", _functions(given))
    law = checked(Law(family=family, parameters=family.parameters({}, -math.inf, math.inf)))
    if not all(map(math.isinf, law.tail_orders())):
        raise LawError(f"{given} has a heavy tail, which chaospy cuts off: give the law of scipy.stats")
    return law


def _unrolled(given: Distribution) -> Law | None:
    """A law of chaospy, which is another one truncated, or moved and stretched; None where the last is not known."""
    shift, scale = 0.0, 1.0
    while (inner := getattr(given, "_dist", None)) is not None:
        own = {key: _number(value) for key, value in given._parameters.items()}
        if type(given).__name__ == "Trunc":
            law = _unrolled(inner)
            ends = {key: own[key] for key in ("lower", "upper") if _number(getattr(inner, key)) != own[key]}
            untouched = (shift, scale) == (0.0, 1.0) and law is not None and not law.family.bounded
            return as_law(law_table(law) | ends) if untouched else None
        if "lower" in own:
            low, high = _number(inner.lower), _number(inner.upper)
            own["scale"] = (own["upper"] - own["lower"]) / (high - low)
            own["shift"] = own["lower"] - low * own["scale"]
        shift, scale = shift + scale * own["shift"], scale * own["scale"]
        given = inner
    made = _CHAOSPY.get(type(given).__name__)
    if made is None:
        return None
    name, *shapes, loc, unit = made(*map(_number, given._parameters.values()))
    return _of_scipy(str(name), *map(float, shapes), shift + scale * float(loc), scale * float(unit))


def _number(value: npt.ArrayLike) -> float:
    return float(np.ravel(value)[0])


def _functions(law: Distribution) -> SimpleNamespace:
    """The functions of a distribution of chaospy; its upper tail is what its distribution function leaves of 1."""

    def shaped(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
        # chaospy takes values (n,) or (1, n)
        return lambda values: np.asarray(function(np.ravel(values)), dtype=float).reshape(np.shape(values))

    cdf, ppf = shaped(law.cdf), shaped(law.inv)

    def stats(moments: str) -> tuple[float, float]:
        """Mean and variance, by the trapezoidal rule over normal scores; no variance where a tail is heavy."""
        from scipy.special import ndtr

        z = np.linspace(-6.0, 6.0, 1537)
        weights, values = np.exp(-0.5 * z * z), ppf(np.asarray(ndtr(z)))
        weights /= weights.sum()
        far = np.abs(ppf(np.array([1e-6, 1e-9, 1.0 - 1e-6, 1.0 - 1e-9])))
        heavy = max(far[1] / far[0], far[3] / far[2]) > 10.0
        return float(weights @ values), math.inf if heavy else float(weights @ (values - weights @ values) ** 2)

    return SimpleNamespace(
        cdf=cdf,
        sf=lambda values: 1.0 - cdf(values),
        ppf=ppf,
        isf=lambda shares: ppf(1.0 - np.asarray(shares)),
        pdf=shaped(law.pdf),
        stats=stats,
    )


def joint_of(laws: Joint | Mapping[str, LawLike], dependence: Sequence[Dependence] = ()) -> Joint:
    """Named laws, of whatever origin, with what ties them; a `Joint` as it is."""
    if isinstance(laws, Joint):
        return laws
    if not isinstance(laws, Mapping):
        raise LawError(f"a mapping of name to law, or a Joint, is due; found {type(laws).__name__}")
    return make_joint(tuple(laws), tuple(as_law(law) for law in laws.values()), dependence)
