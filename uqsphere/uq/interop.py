"""Joint laws, expansions and designs as chaospy and SALib have them: the file that loads chaospy."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import UsageError
from uqsphere.uq.estimate import Estimate, absent, from_replicates, student
from uqsphere.uq.expansion.germs import GermLike, recurrence_of
from uqsphere.uq.indices import Blocks, mean_expansion, uniform_halves
from uqsphere.uq.joint import Joint
from uqsphere.uq.law import Law
from uqsphere.uq.response import Response

if TYPE_CHECKING:
    from types import ModuleType

    from chaospy import Distribution as Distribution
    from numpoly import ndpoly

# --- chaospy ----------------------------------------------------------------------------------------------------


def load_chaospy() -> Any:
    """The package chaospy, imported without a trace; raises UsageError where it is not installed."""
    with _quiet_chaospy():
        try:
            import chaospy
        except ImportError as error:
            raise UsageError("this needs chaospy: uqsphere doctor says how to install it") from error
    return chaospy


@contextmanager
def _quiet_chaospy() -> Iterator[None]:
    """On import chaospy turns the root logger to DEBUG and adds a handler of its own: both are undone."""
    import logging
    import warnings

    root = logging.getLogger()
    level, handlers = root.level, list(root.handlers)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        root.setLevel(level)
        for handler in list(root.handlers):
            if handler not in handlers:
                root.removeHandler(handler)
                handler.close()


#: laws that chaospy has exactly, for its own three-term recurrences
_CHAOSPY: Final[Mapping[str, Callable[[ModuleType, Law], Distribution]]] = {
    "normal": lambda chaospy, law: chaospy.Normal(law.parameters["mean"], law.parameters["sd"]),
    "uniform": lambda chaospy, law: chaospy.Uniform(law.lower, law.upper),
    "lognormal": lambda chaospy, law: chaospy.LogNormal(law.parameters["log_mean"], law.parameters["log_sd"]),
    "beta": lambda chaospy, law: chaospy.Beta(
        law.parameters["alpha"], law.parameters["beta"], law.lower, law.upper
    ),
}  # fmt: skip


def joint_to_chaospy(inputs: Joint) -> Distribution:
    """The joint law as a distribution of chaospy: `J` of independent laws, `Nataf` where a Gaussian copula ties them.

    Laws that chaospy has not, or truncated ones, keep the functions of this package, bounded by their quantiles at
    1e-15.  Raises UsageError for other copulas.
    """
    chaospy = load_chaospy()
    if inputs.groups:
        kinds = ", ".join(group.copula.label for group in inputs.groups)
        raise UsageError(f"chaospy has no copula of this form: {kinds}; only a Gaussian one goes over")
    laws = [_law_to_chaospy(chaospy, law) for law in inputs.laws]
    if inputs.correlation is None:
        return laws[0] if len(laws) == 1 else chaospy.J(*laws)
    return chaospy.Nataf(chaospy.J(*laws), inputs.correlation)


def _law_to_chaospy(chaospy: ModuleType, law: Law) -> Distribution:
    made = _CHAOSPY.get(law.family.name)
    if made is not None and (law.family.bounded or (np.isinf(law.lower) and np.isinf(law.upper))):
        return made(chaospy, law)
    low, high = (float(end[0]) for end in (law.ppf(np.array([1e-15])), law.isf(np.array([1e-15]))))
    density = None if law.is_steps else law.pdf
    return chaospy.UserDistribution(
        cdf=law.cdf, pdf=density, lower=lambda: low, upper=lambda: high,
        ppf=lambda p: np.clip(law.ppf(np.asarray(p)), low, high),
    )  # fmt: skip


def expansion_to_chaospy(response: Response) -> ndpoly:
    """The mean of a response's fits as a polynomial of chaospy in q0, q1, ..., its germs.

    Raises UsageError where it is none: of an output that was expanded by its logarithm, say, or in two pieces.
    """
    if not all(fit.plain for fit in response.fits):
        kinds = ", ".join(sorted({fit.transform if fit.border is None else "two pieces" for fit in response.fits}))
        raise UsageError(f"the surrogate is no polynomial ({kinds}): fit one with plain=True")
    if len({fit.germs for fit in response.fits}) > 1:
        raise UsageError("the folds are polynomials of different germs, and their mean is none")
    load_chaospy()
    import numpoly

    mean = mean_expansion(response.fits)
    piece = mean.pieces[0]
    highest = piece.multi_indices.max(axis=0)
    powers = [_powers(germ, int(top)) for germ, top in zip(mean.germs, highest, strict=True)]
    total = np.zeros(tuple(highest + 1))
    for coefficient, degrees in zip(piece.coefficients, piece.multi_indices, strict=True):
        part = np.array(coefficient)
        for table, degree in zip(powers, degrees, strict=True):
            part = np.multiply.outer(part, table[degree])
        total += part
    exponents = np.argwhere(total != 0.0)
    if not len(exponents):
        exponents = np.zeros((1, total.ndim), dtype=np.int64)
    names = [f"q{k}" for k in range(total.ndim)]
    return numpoly.ndpoly.from_attributes(exponents=exponents, coefficients=list(total[tuple(exponents.T)]),
                                          names=names, retain_names=True)  # fmt: skip


def _powers(germ: GermLike, degree: int) -> Array:
    """Coefficients (degree + 1, degree + 1) of the powers of the orthonormal polynomials of a germ."""
    a, b = recurrence_of(germ, degree)
    table = np.zeros((degree + 1, degree + 1))
    table[0, 0] = 1.0
    for k in range(degree):
        table[k + 1, 1:] = table[k, :-1]
        table[k + 1] -= a[k] * table[k]
        if k:
            table[k + 1] -= np.sqrt(b[k]) * table[k - 1]
        table[k + 1] /= np.sqrt(b[k + 1])
    return table


# --- SALib ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class SalibDesign:
    """A problem of SALib with rows (N (d + 2), d), or (N (2 d + 2), d) for pairs, in the order of its Sobol' analysis.

    `SALib.analyze.sobol.analyze(design.problem, model(design.rows), calc_second_order=design.second)`.
    """

    problem: dict[str, object]
    rows: Array
    second: bool = False


def to_salib(inputs: Joint, count: int = 1024, *, second: bool = False, seed: int = 0) -> SalibDesign:
    """The design of this package's Sobol' indices at `count` base points of one randomisation, as SALib orders it.

    SALib knows few laws: its rows are mapped here, and the problem names the bounds where each law begins and ends to
    1e-15.  Raises UsageError for inputs that depend on each other, of which SALib's indices would not share out the
    variance.
    """
    if inputs.dependent:
        raise UsageError("the inputs depend on each other, which SALib's Sobol' indices do not allow for")
    from scipy.special import ndtri

    d = len(inputs.names)
    blocks = Blocks(inputs_count=d, second=second)
    halves = uniform_halves(blocks, count=count, seed=seed, task="sensitivity", replicate=0)
    mixed = blocks.mix(*(inputs.physical(np.asarray(ndtri(half))) for half in halves))
    # here the blocks are A, AB, B, BA; SALib has B last
    order = [*range(d + 1), *range(d + 2, 2 * d + 2), d + 1] if second else list(range(d + 2))
    ends = [[float(law.ppf(np.array([1e-15]))[0]), float(law.isf(np.array([1e-15]))[0])] for law in inputs.laws]
    problem: dict[str, object] = {"num_vars": d, "names": list(inputs.names), "bounds": ends}
    return SalibDesign(problem=problem, rows=mixed[:, order].reshape(-1, d), second=second)


def load_salib() -> None:
    """What `salib_check` takes long to load: pandas and SciPy's statistics come with it."""
    import SALib.analyze.sobol  # noqa: F401


def salib_indices(outputs: Array) -> dict[str, list[Estimate]]:
    """First and total indices by SALib's estimators from outputs (R, N, d + 2) at blocks A, AB_1 ... AB_d, B.

    SALib's own intervals are those of a bootstrap of Sobol' points, which are several times too wide: here they are
    those of the R randomisations.  There are none where the output is constant in A and B of a randomisation.
    """
    from SALib.analyze.sobol import first_order, total_order

    # a power of two rounds nothing, and keeps the squares of 1e300 and of 1e-300 inside floating point
    y = np.ldexp(outputs, -int(np.frexp(np.abs(outputs).max())[1]))
    y = (y - y.mean()) / (float(y.std()) or 1.0)
    count, none = y.shape[2] - 2, absent("the output is constant in a randomisation", "SALib", outputs.size)
    if not np.ptp(y[:, :, [0, -1]], axis=(1, 2)).all():  # SALib calls both indices of a constant zero, with a warning
        return {"first": [none] * count, "total": [none] * count}
    whole = [*y, y.reshape(-1, count + 2)]  # each randomisation, and all as one
    found: dict[str, list[Estimate]] = {}
    for order, estimator in (("first", first_order), ("total", total_order)):
        rows = [[float(estimator(r[:, 0], r[:, j], r[:, -1])) for r in whole] for j in range(1, count + 1)]
        found[order] = [from_replicates(np.array(row[:-1]), "SALib", outputs.size, row[-1]) for row in rows]
    return found


def salib_check(names: Sequence[str], ours: Mapping[str, Sequence[Estimate]], outputs: Array) -> tuple[bool, str]:
    """Whether sampled indices are those of SALib's estimators on the same rows (R, N, d + 2), and a sentence of it.

    They agree where they differ by no more than our half-width and that of SALib's value over the randomisations, the
    last at 99.9 %.
    """
    from scipy.special import stdtrit

    # of 1 - 5e-4 rather than 95 %: dozens of indices are compared, and none may differ by chance
    factor = float(stdtrit(outputs.shape[0] - 1.0, 0.9995)) / student(outputs.shape[0])
    theirs = salib_indices(outputs)
    apart, largest, compared = [], 0.0, 0
    for order, rows in theirs.items():
        for name, one, other in zip(names, ours[order], rows, strict=True):
            if one.value is None or other.value is None:
                continue
            compared += 1
            difference = abs(one.value - other.value)
            largest = max(largest, difference)
            if difference > one.half_width + factor * other.half_width + 1e-9:
                apart.append(f"{order} of {name} ({one.value:.4f} against {other.value:.4f})")
    if not compared:
        return True, ""
    if apart:
        return False, f"SALib's estimators on the same rows disagree: {'; '.join(apart)}."
    return True, f"SALib's estimators on the same rows agree on {compared} (largest difference {largest:.2g})."
