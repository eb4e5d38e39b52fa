"""Distributions of SciPy, chaospy and SALib, and observations, as laws of this package.

A common distribution becomes a family of this package, any other of SciPy a family by its name, any
other of chaospy a law by its own functions, whose tails are checked.  No package is imported here:
the class of a distribution says where it is from.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uqsphere.arrays import Function, as_numbers
from uqsphere.files import packaged

from .families import BY_FUNCTIONS, FAMILIES, PREFIX, family_named
from .fitting import fitted_law
from .forms import LawError
from .joint import Dependence, Joint, make_joint
from .law import Law, discrete_law, make_law

#: a law, its table as in a study, a distribution of scipy.stats or chaospy, or observations (n,)
LawLike = Any

_NAMES = packaged("uq/foreign.toml")
#: families, or SciPy's names, by the names of other packages, as explained in foreign.toml
DIRECT = _NAMES["scipy"]
CHAOSPY = _NAMES["chaospy"]
SALIB = _NAMES["salib"]
#: bounded families by SciPy's names: its shapes, loc and scale -> family, bounds and parameters
BOUNDED: Mapping[str, Any] = {
    "uniform": lambda loc, scale: ("uniform", loc, loc + scale),
    "loguniform": lambda a, b, loc, scale: ("loguniform", loc + scale * a, loc + scale * b),
    "triang": lambda c, loc, scale: ("triangular", loc, loc + scale, loc + c * scale),
    "beta": lambda a, b, loc, scale: ("beta", loc, loc + scale, a, b),
    "truncnorm": lambda a, b, loc, scale: ("normal", loc + a * scale, loc + b * scale, loc, scale),
}

#: the way out for laws of several numbers
EACH = (
    "give each number its own law by name, and their rank correlations by uqsphere.analysis.joint"
)


def law_table(distribution: LawLike) -> dict[str, Any]:
    """The table by which a study file has a law, or a distribution of SciPy or chaospy.

    Raises LawError for anything else, and for a law that has no table: observations, or functions
        of chaospy.
    """
    law = as_law(distribution)
    if law.family.name == "discrete":
        return {"dist": "discrete", "values": law.data}
    if law.family.observed or law.data:
        raise LawError(
            "a study file has no table for it: write a sample or the observations to a CSV and "
            'name that, { file = "rows.csv", column = "x" }, or give it to uqsphere.analysis'
        )
    table = {**law.parameters, "lower": law.lower, "upper": law.upper}
    finite = {key: value for key, value in table.items() if math.isfinite(value)}
    return {"dist": law.family.name, **finite}


def as_law(distribution: LawLike) -> Law:
    """A law from a law, its table, SciPy, chaospy, or observations.

    Parameters
    ----------
    distribution : a law, its table (`{"dist": "normal", "mean": 0, "sd": 1}`), a frozen
        distribution of scipy.stats or one of chaospy, taken by its own parameters so that both
        tails keep their digits, or observations (n,), which become a kernel density

    Raises
    ------
    LawError
        For anything else, several numbers at once, discrete laws of unequal probabilities, and
        laws whose tails contradict themselves.

    >>> from scipy import stats
    >>> law = as_law(stats.norm(1.0, 0.1))
    >>> law.family.name, float(law.isf(np.array([1e-30]))[0].round(9))
    ('normal', 2.146402469)
    """
    if isinstance(distribution, Law):
        return distribution
    if isinstance(distribution, Mapping):
        return _of_table(distribution)
    kind = type(distribution).__name__
    origin = type(distribution).__module__.partition(".")[0]
    if origin == "scipy":
        return _of_scipy(distribution, kind)
    if origin == "chaospy" and hasattr(distribution, "inv"):
        return _of_chaospy(distribution, kind)
    why = ""
    try:
        values = as_numbers(distribution)
        if values.ndim == 1 and values.size >= 2:
            return fitted_law(values.tolist())
    except TypeError as error:
        why = f" ({error})"
    except LawError:
        raise
    except ValueError:
        pass
    raise LawError(
        f"found {kind}{why}: give a law, its table, a distribution of scipy.stats or chaospy, or "
        "observations (n,)"
    )


def _of_table(table: Mapping[str, Any]) -> Law:
    numbers = {key: value for key, value in table.items() if key != "dist"}
    if table.get("dist") == "discrete" and set(numbers) <= {"values", "weights"}:
        return discrete_law(table.get("values", ()), table.get("weights"))
    for key, value in numbers.items():
        if not isinstance(value, int | float | np.number):
            raise LawError(
                f"{key} of a law must be a number; observations are given as an array in its place",
                key,
            )
    lower = numbers.pop("lower", None)
    upper = numbers.pop("upper", None)
    return make_law(str(table.get("dist")), numbers, lower, upper)


def _bounded(name: str, lower: float, upper: float, *parameters: float) -> Law:
    return make_law(name, dict(zip(FAMILIES[name].keys, parameters, strict=False)), lower, upper)


def _of_scipy(distribution: Any, kind: str) -> Law:
    frozen = getattr(distribution, "dist", None)
    if any("discrete" in base.__name__.lower() for base in type(distribution).__mro__):
        name = f"{getattr(frozen, 'name', kind)} of SciPy"
        return _steps(name, distribution.support(), distribution.pmf)
    if frozen is not None:
        shapes, loc, scale = frozen._parse_args(*distribution.args, **distribution.kwds)
        return _by_name(frozen.name, *shapes, loc, scale)
    if kind in ("Normal", "StandardNormal"):
        return _by_name("norm", distribution.mean(), distribution.standard_deviation())
    if kind == "Uniform":
        lower, upper = distribution.support()
        return _by_name("uniform", lower, upper - lower)
    raise LawError(
        f"{kind} of SciPy: freeze a law with its parameters, as scipy.stats.norm(1.0, 0.1), or "
        f"give observations; {EACH}"
    )


def _of_chaospy(distribution: Any, kind: str) -> Law:
    """A distribution of chaospy by its parameters where it is one of ours, else by its
    functions.
    """
    if len(distribution) != 1:
        raise LawError(f"a joint distribution of chaospy: {EACH}")
    if distribution.interpret_as_integer:
        bounds = distribution.lower, distribution.upper
        return _steps(f"{kind} of chaospy", bounds, distribution.pdf)
    if kind == "Trunc":
        inner = distribution._dist
        parameters = distribution._parameters
        law = as_law(inner)
        if law.family.bounded or law.family.observed:
            # chaospy's own functions of a law with two new ends are wrong
            raise LawError(
                f"{distribution}: give the law that is truncated by its table, with lower and upper"
            )
        # chaospy's own end of the law, some 8 standard deviations out, truncates nothing
        ends = {key: _number(end) for key, end in parameters.items() if end != getattr(inner, key)}
        return as_law(law_table(law) | ends)
    shift = 0.0
    scale = 1.0
    standard = distribution
    while hasattr(standard, "_dist"):
        # lower and upper, or shift and scale
        first, second = map(_number, standard._parameters.values())
        shift += scale * first
        scale *= second - first if "lower" in standard._parameters else second
        standard = standard._dist
    name = type(standard).__name__
    shapes = standard._parameters.values()
    if name == "trunc_normal" and (shift, scale) == (0.0, 1.0):
        return _bounded("normal", *map(_number, shapes))
    if name not in CHAOSPY:
        return Law(family=BY_FUNCTIONS, source=distribution).checked()
    if name == "log_uniform":
        shapes = [math.exp(_number(end)) for end in shapes]
    return _by_name(CHAOSPY[name], *shapes, shift, scale)


def _by_name(name: str, *parameters: Any) -> Law:
    """The law by its name, shapes, loc and scale in SciPy."""
    numbers = [_number(parameter) for parameter in parameters]
    if name in BOUNDED and not (name == "loguniform" and numbers[-2] != 0.0):
        return _bounded(*BOUNDED[name](*numbers))
    if name in DIRECT:
        family, keys = DIRECT[name]
        table = dict(zip(keys.split(), numbers, strict=True))
        if not table.pop("-", 0.0):
            if "log_mean" in table:
                table["log_mean"] = math.log(table["log_mean"])
            return make_law(family, table)
    other = family_named(PREFIX + name)
    if other is None:
        raise LawError(
            f"scipy.stats has no law {name!r} by this name: give it by rows of its values"
        )
    return make_law(other.name, dict(zip(other.parameters_of, numbers, strict=True)))


def _steps(name: str, ends: Sequence[ArrayLike], share: Function) -> Law:
    """A discrete law whose whole numbers are all as probable as each other."""
    low, high = map(_number, ends)
    if 1.0 <= high - low < 1e4:
        values = np.arange(math.ceil(low), math.floor(high) + 1, dtype=float)
        shares = np.ravel(share(values))
        if np.ptp(shares) <= 1e-9 * shares.max():
            return discrete_law(values.tolist())
    raise LawError(
        f"{name} is discrete, and its values are not equally probable: give them as "
        '{"dist": "discrete", "values": [1, 2, 3], "weights": [2, 3, 5]}'
    )


def _number(value: ArrayLike) -> float:
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
        raise LawError(
            f"found {type(laws).__name__}, allowed: a mapping of name to law, a problem of SALib, "
            f"or a Joint; {EACH}"
        )
    return make_joint({name: as_law(law) for name, law in of_salib(laws).items()}, dependence)


def of_salib(problem: Mapping[str, Any]) -> Mapping[str, Any]:
    """The inputs that a problem dict of SALib is about, by name; any other mapping as it is."""
    if not {"num_vars", "bounds"} <= set(problem):
        return problem
    count = int(problem["num_vars"])
    bounds = problem["bounds"]
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
    kinds = problem.get("dists") or ["unif"] * count
    laws = {}
    try:
        for name, kind, numbers in zip(names, kinds, bounds, strict=True):
            family, keys = SALIB[kind]
            table = dict(zip(keys.split(), map(float, numbers), strict=True))
            if "mode" in table:
                table["mode"] = table["lower"] + table["mode"] * (table["upper"] - table["lower"])
            laws[str(name)] = {"dist": family} | table
    except (KeyError, TypeError, ValueError) as error:
        raise LawError(
            f"found dists {kinds} with bounds {list(bounds)}; known: {', '.join(SALIB)}, each with "
            "its two to four numbers",
            "bounds",
        ) from error
    return laws
