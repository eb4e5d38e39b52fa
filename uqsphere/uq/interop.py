"""Joint laws as chaospy has them, and SALib's problems, designs and analyses: the file that loads both packages."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.errors import UsageError
from uqsphere.uq.estimate import Estimate, absent, from_replicates
from uqsphere.uq.indices import Blocks, base_points
from uqsphere.uq.joint import Joint
from uqsphere.uq.law import Law

if TYPE_CHECKING:
    from types import ModuleType

    from chaospy import Distribution

# --- chaospy ----------------------------------------------------------------------------------------------------


def load_chaospy() -> Any:
    """The package chaospy; raises UsageError where it is not installed.

    On import it turns the root logger to DEBUG and adds a handler of its own: both are undone.
    """
    root = logging.getLogger()
    level, handlers = root.level, list(root.handlers)
    try:
        with warnings.catch_warnings(action="ignore"):
            import chaospy
    except ImportError as error:
        raise UsageError("this needs chaospy: pip install chaospy") from error
    finally:
        root.setLevel(level)
        root.handlers[:] = handlers
    return chaospy


#: laws that chaospy has exactly, for its own three-term recurrences
CHAOSPY: Final[Mapping[str, Callable[[ModuleType, Law], Distribution]]] = {
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
    1e-15.  Raises UsageError for Student t copulas.
    """
    chaospy = load_chaospy()
    if any(np.isfinite(copula.dof) for _, copula in inputs.blocks):
        raise UsageError("chaospy has no Student t copula of this form; only a Gaussian one goes over")
    laws = [_law_to_chaospy(chaospy, law) for law in inputs.laws]
    if inputs.correlation is None:
        return laws[0] if len(laws) == 1 else chaospy.J(*laws)
    return chaospy.Nataf(chaospy.J(*laws), inputs.correlation)


def _ends(law: Law) -> list[float]:
    """Quantiles beyond which 1e-15 is left."""
    return [law.ppf(np.array(1e-15)).item(), law.isf(np.array(1e-15)).item()]


def _law_to_chaospy(chaospy: ModuleType, law: Law) -> Distribution:
    made = CHAOSPY.get(law.family.name)
    if made is not None and (law.family.bounded or (np.isinf(law.lower) and np.isinf(law.upper))):
        return made(chaospy, law)
    low, high = _ends(law)
    return chaospy.UserDistribution(
        cdf=law.cdf, pdf=None if law.is_steps else law.pdf, lower=lambda: low, upper=lambda: high,
        ppf=lambda p: np.clip(law.ppf(np.asarray(p)), low, high),
    )  # fmt: skip


# --- SALib ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class SalibDesign:
    """A problem of SALib with rows (N (d + 2), d), or (N (2 d + 2), d) for pairs, in the order of its Sobol' analysis.

    `SALib.analyze.sobol.analyze(design.problem, model(design.rows), calc_second_order=design.second)`; `outputs` are
    the answers where the model was run already.
    """

    problem: dict[str, object]
    rows: Array
    second: bool = False
    outputs: Array | None = None


def salib_problem(inputs: Joint) -> dict[str, object]:
    """The problem dict: SALib knows few laws, so the bounds are where each law begins and ends to 1e-15.

    Raises UsageError for inputs that depend on each other, of which SALib's indices would not share out the variance.
    """
    if inputs.dependent:
        raise UsageError("the inputs depend on each other, which SALib's indices do not allow for")
    return {"num_vars": len(inputs.names), "names": list(inputs.names), "bounds": list(map(_ends, inputs.laws))}


def to_salib(inputs: Joint, count: int = 1024, *, second: bool = False, seed: int = 0) -> SalibDesign:
    """The design of this package's Sobol' indices at `count` base points of one randomisation, in SALib's row order."""
    blocks = Blocks(inputs_count=len(inputs.names), second=second)
    problem = salib_problem(inputs)
    halves = base_points(blocks, count=count, seed=seed, task="sensitivity", replicate=0)
    mixed = blocks.mix(*(inputs.physical(np.asarray(special.ndtri(half))) for half in halves))
    return SalibDesign(problem=problem, rows=mixed.reshape(-1, blocks.inputs_count), second=second)


#: methods of SALib that a study may name
SALIB_METHODS: Final = ("morris", "delta", "pawn", "hdmr")


def morris_rows(inputs: Joint, count: int, *, seed: int = 0) -> tuple[Array, Array]:
    """Uniform rows (count (d + 1), d) of SALib's trajectories on four levels, and the physical rows they stand for."""
    from SALib.sample import morris

    problem = _unit_problem(salib_problem(inputs)["names"])
    # the levels 0 and 1 are the ends of a law that may have none
    uniforms = 0.125 + 0.75 * np.asarray(morris.sample(problem, count, num_levels=4, seed=seed))
    return uniforms, inputs.physical(np.asarray(special.ndtri(uniforms)))


def _unit_problem(names: Any) -> dict[str, Any]:
    return {"num_vars": len(names), "names": list(names), "bounds": [[0.0, 1.0]] * len(names)}


def salib_measures(
    method: str, uniforms: Array, outputs: Array, names: Sequence[str], *, seed: int = 0
) -> list[Estimate]:
    """SALib's measure of every input from uniform rows (n, d) and outputs (n,).

    mu* of Morris, from rows of `morris_rows`, has the interval of the independent trajectories by Student's law; for
    delta, the median of PAWN and the total index of HDMR nobody knows one that covers (delta of an input that does
    nothing comes out at 0.065), and they have none.
    """
    shown = f"SALib {method}"
    if not np.isfinite(outputs).all():
        # SALib answers zeros, without a word, where one output is not finite
        return [absent("outputs that are not finite: SALib would answer zeros", shown, outputs.size)] * len(names)
    d, problem, scale = len(names), _unit_problem(names), float(outputs.std()) or 1.0
    y = (outputs - outputs.mean()) / scale
    if method == "morris":
        u, values = uniforms.reshape(-1, d + 1, d), y.reshape(-1, d + 1)
        step, rise = np.diff(u, axis=1), np.diff(values, axis=1)
        moved = np.abs(step).argmax(axis=2)
        effects = np.zeros((len(u), d))
        np.put_along_axis(effects, moved, np.abs(rise / np.abs(step).max(axis=2)) * scale, axis=1)
        return [from_replicates(effects[:, j], f"{shown}, mu*", outputs.size) for j in range(d)]
    from SALib.analyze import delta, enhanced_hdmr, pawn

    if method == "delta":
        answers = delta.analyze(problem, uniforms, y, num_resamples=2, seed=seed)
        found = answers["delta"] if "delta" in answers else answers["delta_balanced"]
    elif method == "pawn":
        found = pawn.analyze(problem, uniforms, y, S=10, seed=seed)["median"]
    elif method == "hdmr":
        # one bootstrap of all rows is the sample itself
        found = enhanced_hdmr.analyze(problem, uniforms, y, max_order=min(2, d), bootstrap=1, subset=len(y),
                                      seed=seed)["ST"][:d]  # fmt: skip
    else:
        raise UsageError(f"unknown method {method!r}; known: {', '.join(SALIB_METHODS)}")
    return [Estimate(value=float(value), low=None, high=None, std_error=None, method=shown, evaluations=outputs.size)
            for value in np.asarray(found, dtype=float)]  # fmt: skip
