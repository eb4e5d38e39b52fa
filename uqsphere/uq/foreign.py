"""Laws of SciPy, chaospy and SALib, and observations, as laws of this package: of a family of its
own where there is one, else of SciPy's.  No package is imported here: the class of what is given
says where it is from.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.families import PREFIX, family_named
from uqsphere.uq.fitting import fitted_law
from uqsphere.uq.forms import LawError
from uqsphere.uq.joint import Dependence, Joint, make_joint
from uqsphere.uq.law import Law, discrete_law, make_law

#: a law, its table as in a study, a distribution of scipy.stats or chaospy, or observations (n,)
LawLike: TypeAlias = Any
#: the keys of a law in a study: `dist`, parameters and bounds
Table: TypeAlias = dict[str, Any]

#: families of this package by SciPy's names, from shapes, loc and scale
TABLES: Final[Mapping[str, Callable[..., Table]]] = {
    "norm": lambda loc, scale: {"dist": "normal", "mean": loc, "sd": scale},
    "lognorm": lambda s, _, scale: {"dist": "lognormal", "log_mean": math.log(scale), "log_sd": s},
    "uniform": lambda loc, scale: {"dist": "uniform", "lower": loc, "upper": loc + scale},
    "loguniform": lambda a, b, _, scale: {
        "dist": "loguniform",
        "lower": scale * a,
        "upper": scale * b,
    },
    "triang": lambda c, loc, scale: {
        "dist": "triangular",
        "mode": loc + c * scale,
        "lower": loc,
        "upper": loc + scale,
    },
    "beta": lambda a, b, loc, scale: {
        "dist": "beta",
        "lower": loc,
        "upper": loc + scale,
        "alpha": a,
        "beta": b,
    },
    "gamma": lambda a, _, scale: {"dist": "gamma", "shape": a, "scale": scale},
    "weibull_min": lambda c, loc, scale: {
        "dist": "weibull",
        "modulus": c,
        "scale": scale,
        "threshold": loc,
    },
    "gumbel_r": lambda loc, scale: {"dist": "gumbel", "location": loc, "scale": scale},
    "invweibull": lambda c, loc, scale: {
        "dist": "frechet",
        "shape": c,
        "scale": scale,
        "location": loc,
    },
    "expon": lambda _, scale: {"dist": "exponential", "rate": 1.0 / scale},
    "rayleigh": lambda _, scale: {"dist": "rayleigh", "scale": scale},
    "t": lambda df, loc, scale: {"dist": "student_t", "dof": df, "location": loc, "scale": scale},
    "truncnorm": lambda a, b, loc, scale: {
        "dist": "normal",
        "mean": loc,
        "sd": scale,
        "lower": loc + scale * a,
        "upper": loc + scale * b,
    },
}

#: those of them that have no place for a loc other than 0
UNSHIFTED: Final = ("lognorm", "loguniform", "gamma", "expon", "rayleigh")

#: SciPy's names of chaospy's laws in standard form, which have the same shapes
CHAOSPY: Final = {
    "normal": "norm",
    "log_normal": "lognorm",
    "uniform": "uniform",
    "beta_": "beta",
    "triangle": "triang",
    "gamma": "gamma",
    "inverse_gamma": "invgamma",
    "log_gamma": "loggamma",
    "double_gamma": "dgamma",
    "generalized_gamma": "gengamma",
    "chi": "chi",
    "chi_squared": "ncx2",
    "student_t": "t",
    "weibull": "weibull_min",
    "frechet": "weibull_min",
    "double_weibull": "dweibull",
    "log_weibull": "gumbel_r",
    "exponential_weibull": "exponweib",
    "generalized_extreme": "genextreme",
    "gompertz": "gompertz",
    "fisk": "fisk",
    "burr": "burr12",
    "mielke": "mielke",
    "pareto1": "pareto",
    "pareto2": "lomax",
    "cauchy": "cauchy",
    "levy": "levy",
    "folded_cauchy": "foldcauchy",
    "wrapped_cauchy": "wrapcauchy",
    "laplace": "laplace",
    "log_laplace": "loglaplace",
    "logistic": "genlogistic",
    "generalized_half_logistic": "genhalflogistic",
    "folded_normal": "foldnorm",
    "power_normal": "powernorm",
    "power_log_normal": "powerlognorm",
    "exponential_power": "exponpow",
    "generalized_exponential": "genexpon",
    "truncexpon": "truncexpon",
    "fatigue_life": "fatiguelife",
    "nakagami": "nakagami",
    "wald": "recipinvgauss",
    "alpha": "alpha",
    "anglit": "anglit",
    "bradford": "bradford",
    "reciprocal": "loguniform",
    "tukey_lambda": "tukeylambda",
}

#: the way out for laws of several numbers
EACH: Final = (
    "give each number its own law by name, and their rank correlations by uqsphere.analysis.joint"
)

#: SALib's distributions by their names, from the two to four numbers that it calls bounds
SALIB: Final[Mapping[str, Callable[..., Table]]] = {
    "unif": lambda a, b: {"dist": "uniform", "lower": a, "upper": b},
    "logunif": lambda a, b: {"dist": "loguniform", "lower": a, "upper": b},
    "norm": lambda m, s: {"dist": "normal", "mean": m, "sd": s},
    "truncnorm": lambda a, b, m, s: {"dist": "normal", "mean": m, "sd": s, "lower": a, "upper": b},
    "lognorm": lambda m, s: {"dist": "lognormal", "log_mean": m, "log_sd": s},
    "triang": lambda a, b, c: {
        "dist": "triangular",
        "lower": a,
        "upper": b,
        "mode": a + c * (b - a),
    },
}


def law_table(given: LawLike) -> Table:
    """The table by which a study file has a law: that of a distribution of SciPy or chaospy, or of
    a law.

    Raises LawError for what is no such distribution, or has no table: observations.
    """
    if isinstance(given, Mapping):
        return dict(given)
    law = as_law(given)
    if law.family.name == "discrete":
        return {"dist": "discrete", "values": list(law.data)}
    if law.data or law.draws:
        raise LawError(
            "a study file has no table for it: write a sample or the observations to a CSV and "
            "name that, "
            '{ file = "rows.csv", column = "x" }, or give it to uqsphere.analysis'
        )
    ends = {"lower": law.lower, "upper": law.upper}
    return {
        "dist": law.family.name,
        **law.parameters,
        **{key: end for key, end in ends.items() if math.isfinite(end)},
    }


def as_law(given: LawLike) -> Law:
    """A law from a law, its table (`{"dist": "normal", "mean": 0, "sd": 1}`), SciPy, chaospy, or
    observations (n,).

    A distribution is taken by its own parameters, so that both tails keep their digits.
    Observations become a kernel density.

    Raises LawError for anything else, several numbers at once, discrete laws, and laws whose tails
    contradict themselves.

    >>> from scipy import stats
    >>> law = as_law(stats.norm(1.0, 0.1))
    >>> law.family.name, float(law.isf(np.array([1e-30]))[0].round(9))
    ('normal', 2.146402469)
    """
    if isinstance(given, Law):
        return given
    if isinstance(given, Mapping):
        return _of_table(given)
    origin, kind = type(given).__module__.partition(".")[0], type(given).__name__
    if origin == "scipy":
        return _of_scipy(given, kind)
    if origin == "chaospy" and hasattr(given, "inv"):
        return _of_chaospy(given, kind)
    try:
        values = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        values = np.zeros(0)
    if values.ndim == 1 and values.size >= 2:
        return fitted_law(values.tolist())
    ways = "a law, its table, a distribution of scipy.stats or chaospy, or observations (n,)"
    raise LawError(f"found {kind}: give {ways}")


def _of_table(given: Mapping[str, Any]) -> Law:
    numbers = {key: value for key, value in given.items() if key != "dist"}
    if given.get("dist") == "discrete" and set(numbers) <= {"values", "weights"}:
        return discrete_law(given.get("values", ()), given.get("weights"))
    for key, value in numbers.items():
        if not isinstance(value, int | float | np.number):
            raise LawError(
                f"{key} of a law must be a number; observations are given as an array in its place",
                key,
            )
    bounds = numbers.pop("lower", None), numbers.pop("upper", None)
    return make_law(str(given.get("dist")), numbers, *bounds)


def _of_scipy(given: Any, kind: str) -> Law:
    frozen = getattr(given, "dist", None)
    if any("discrete" in base.__name__.lower() for base in type(given).__mro__):
        return _steps(f"{getattr(frozen, 'name', kind)} of SciPy", given.support(), given.pmf)
    if frozen is not None:
        shapes, loc, scale = frozen._parse_args(*given.args, **given.kwds)
        return _by_name(frozen.name, *shapes, loc, scale)
    if kind in ("Normal", "StandardNormal"):
        return _by_name("norm", given.mean(), given.standard_deviation())
    if kind == "Uniform":
        return _by_name("uniform", given.support()[0], np.subtract(*given.support()[::-1]))
    raise LawError(
        f"{kind} of SciPy: freeze a law with its parameters, as scipy.stats.norm(1.0, 0.1), or "
        "give "
        f"observations; {EACH}"
    )


def _of_chaospy(given: Any, kind: str) -> Law:
    if len(given) != 1:
        raise LawError(f"a joint distribution of chaospy: {EACH}")
    if given.interpret_as_integer:
        return _steps(f"{kind} of chaospy", (given.lower, given.upper), given.pdf)
    if kind == "Trunc":
        law, own = as_law(given._dist), given._parameters
        if law.family.bounded:
            raise LawError(
                f"{given}: give the law that is truncated by its table, with lower and upper"
            )
        # chaospy's own end of the law, some 8 standard deviations out, truncates nothing
        return as_law(
            law_table(law)
            | {key: _number(own[key]) for key in own if own[key] != getattr(given._dist, key)}
        )
    shift, scale, standard = 0.0, 1.0, given
    while hasattr(standard, "_dist"):
        first, second = map(
            _number, standard._parameters.values()
        )  # lower and upper, or shift and scale
        shift += scale * first
        scale *= second - first if "lower" in standard._parameters else second
        standard = standard._dist
    kind, shapes = type(standard).__name__, standard._parameters.values()
    if kind == "log_uniform":
        return _by_name("loguniform", *map(np.exp, shapes), shift, scale)
    if kind == "trunc_normal":
        return as_law(SALIB["truncnorm"](*map(_number, shapes)))
    if kind not in CHAOSPY:
        raise LawError(f"{given}: give the law of scipy.stats, or observations")
    return _by_name(CHAOSPY[kind], *shapes, shift, scale)


def _by_name(name: str, *given: Any) -> Law:
    """The law by its name, shapes, loc and scale in SciPy."""
    numbers = list(map(_number, given))
    if name in TABLES and not (name in UNSHIFTED and numbers[-2]):
        return as_law(TABLES[name](*numbers))
    family = family_named(PREFIX + name)
    if family is None:
        raise LawError(
            f"scipy.stats has no law {name!r} by this name: give it by rows of its values"
        )
    return as_law({"dist": family.name} | dict(zip(family.parameters_of, numbers, strict=True)))


def _steps(name: str, ends: Sequence[npt.ArrayLike], share: Callable[[Array], Array]) -> Law:
    """A discrete law whose whole numbers are all as probable as each other."""
    low, high = map(_number, ends)
    if 1.0 <= high - low < 1e4:
        values: Array = np.arange(math.ceil(low), math.floor(high) + 1, dtype=float)
        if np.ptp(shares := np.ravel(share(values))) <= 1e-9 * shares.max():
            return discrete_law(values.tolist())
    table = '{"dist": "discrete", "values": [1, 2, 3], "weights": [2, 3, 5]}'
    raise LawError(
        f"{name} is discrete, and its values are not equally probable: give them as {table}"
    )


def _number(value: npt.ArrayLike) -> float:
    if np.size(value) != 1:
        raise LawError(f"several numbers in one law: {EACH}")
    return float(np.ravel(value)[0])


def joint_of(laws: Joint | Mapping[str, LawLike], dependence: Sequence[Dependence] = ()) -> Joint:
    """Named laws, of whatever origin, with what ties them; a `Joint` as it is; a problem dict of
    SALib.
    """
    if isinstance(laws, Joint):
        return laws
    if not isinstance(laws, Mapping):
        ways = "a mapping of name to law, a problem of SALib, or a Joint"
        raise LawError(f"found {type(laws).__name__}, allowed: {ways}; {EACH}")
    laws = of_salib(laws)
    return make_joint(tuple(laws), tuple(as_law(law) for law in laws.values()), dependence)


def of_salib(problem: Mapping[str, Any]) -> Mapping[str, Any]:
    """The inputs that a problem dict of SALib is about, by name; any other mapping as it is."""
    if not {"num_vars", "bounds"} <= set(problem):
        return problem
    count, bounds = int(problem["num_vars"]), problem["bounds"]
    names = list(problem.get("names") or [f"x{k + 1}" for k in range(count)])
    if not count == len(set(names)) == len(names) == len(bounds):
        raise LawError(
            f"num_vars is {count}: as many different names and bounds are required, found {names}",
            "names",
        )
    if len(set(problem.get("groups") or names)) < count:
        raise LawError(
            "groups of SALib have no place here: leave them out, and read the indices by input",
            "groups",
        )
    try:
        kinds = problem.get("dists") or ["unif"] * count
        return {
            str(n): SALIB[kind](*map(float, row))
            for n, kind, row in zip(names, kinds, bounds, strict=True)
        }
    except (KeyError, TypeError) as error:
        hint = f"known: {', '.join(SALIB)}, each with its two to four numbers"
        raise LawError(
            f"found dists {kinds} with bounds {list(bounds)}; {hint}", "bounds"
        ) from error
