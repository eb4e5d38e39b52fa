"""Joint laws as chaospy has them, and SALib's problems, designs and analyses: the file that loads
both packages.
"""

import logging
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from uqsphere.arrays import Array, Names, Pair, frozen, special
from uqsphere.errors import UsageError

from .estimate import Estimate, absent, from_replicates
from .foreign import SALIB
from .indices import Blocks
from .joint import Joint
from .law import Law

if TYPE_CHECKING:
    from chaospy import Distribution

# --- chaospy --------------------------------------------------------------------------------------


def load_chaospy() -> Any:
    """The package chaospy.  On import it turns the root logger to DEBUG and adds a handler: both
    are undone.
    """
    root = logging.getLogger()
    level = root.level
    handlers = list(root.handlers)
    with warnings.catch_warnings(action="ignore"):
        import chaospy
    root.setLevel(level)
    root.handlers[:] = handlers
    return chaospy


#: laws that chaospy has exactly, for its own three-term recurrences: they take the parameters, then
#: bounds of their own
CHAOSPY = {"normal": "Normal", "uniform": "Uniform", "lognormal": "LogNormal", "beta": "Beta"}


def joint_to_chaospy(inputs: Joint) -> "Distribution":
    """The joint law as a distribution of chaospy: `J` of independent laws, `Nataf` where a Gaussian
    copula ties them.

    Laws that chaospy has not, or truncated ones, keep the functions of this package, bounded by
    their quantiles at 1e-15.  Raises UsageError for Student t copulas.
    """
    chaospy = load_chaospy()
    if any(np.isfinite(copula.dof) for _, copula in inputs.blocks):
        raise UsageError(
            "chaospy has no Student t copula of this form; only a Gaussian one goes over"
        )
    laws = [law_to_chaospy(law) for law in inputs.laws]
    if len(laws) == 1:
        return laws[0]
    if not inputs.dependent:
        return chaospy.J(*laws)
    return chaospy.Nataf(chaospy.J(*laws), inputs.correlation)


def _ends(law: Law) -> list[float]:
    """Quantiles beyond which 1e-15 is left."""
    return [float(law.ppf(1e-15)), float(law.isf(1e-15))]


def law_to_chaospy(law: Law, centre: float = 0.0, half: float = 1.0) -> "Distribution":
    """The law of (X - centre)/half, with X of this law, as a distribution of chaospy."""
    chaospy = load_chaospy()
    ends = [(end - centre) / half for end in law.ends]
    if (law.family.bounded or not ends) and law.family.name in CHAOSPY:
        return getattr(chaospy, CHAOSPY[law.family.name])(*law.parameters.values(), *ends)
    low, high = ((end - centre) / half for end in _ends(law))
    return chaospy.UserDistribution(
        cdf=lambda x: law.cdf(centre + half * x),
        pdf=None if law.is_steps else lambda x: half * law.pdf(centre + half * x),
        lower=lambda: low,
        upper=lambda: high,
        ppf=lambda p: np.clip((law.ppf(p) - centre) / half, low, high),
    )


# --- SALib ----------------------------------------------------------------------------------------


@frozen
class SalibDesign:
    """A problem of SALib with rows (N (d + 2), d), or (N (2 d + 2), d) for pairs, in the order of
    its Sobol' analysis.

    `SALib.analyze.sobol.analyze(design.problem, model(design.rows),
    calc_second_order=design.second)`; `outputs` are the answers where the model was run already.
    """

    problem: dict[str, object]
    rows: Array
    second: bool
    outputs: Array | None = None


def salib_problem(inputs: Joint) -> dict[str, object]:
    """The problem dict with the distributions that SALib has: normal, truncated normal, lognormal,
    uniform, loguniform and triangular.  Any other stands as uniform between the ends that leave
    1e-15 beyond them: SALib draws no rows of it, but analyses those of `to_salib`.

    Raises UsageError for inputs that depend on each other, of which SALib's indices would not share
        out the variance.
    """
    if inputs.dependent:
        raise UsageError("the inputs depend on each other, which SALib's indices do not allow for")
    kinds = {(family, len(keys.split())): kind for kind, (family, keys) in SALIB.items()}
    dists = []
    bounds = []
    for law in inputs.laws:
        numbers = [*law.ends, *law.parameters.values()]
        dist = kinds.get((law.family.name, len(numbers)))
        if dist is None:
            dist = "unif"
            numbers = _ends(law)
        if dist == "triang":
            numbers[2] = (numbers[2] - law.lower) / (law.upper - law.lower)
        dists.append(dist)
        bounds.append(numbers)
    return _unit_problem(inputs.names) | {"bounds": bounds, "dists": dists}


def to_salib(
    inputs: Joint, count: int = 1024, *, second: bool = False, seed: int = 0
) -> SalibDesign:
    """The design of this package's Sobol' indices at `count` base points of one randomisation, in
    SALib's row order.
    """
    blocks = Blocks(inputs_count=len(inputs.names), second=second)
    problem = salib_problem(inputs)
    halves = blocks.base_points(count, seed=seed, task="sensitivity", replicate=0)
    rows = inputs.physical(special.ndtri(blocks.mix(*halves)))
    return SalibDesign(problem=problem, rows=rows.reshape(-1, blocks.inputs_count), second=second)


#: methods of SALib that a study may name
SALIB_METHODS = ("morris", "delta", "pawn")


def morris_rows(inputs: Joint, count: int, *, seed: int) -> Pair:
    """Uniform rows (count (d + 1), d) of SALib's trajectories on four levels, and the physical rows
    they stand for.
    """
    from SALib.sample import morris

    problem = _unit_problem(inputs.names)
    # the levels 0 and 1 are the ends of a law that may have none
    uniforms = 0.125 + 0.75 * morris.sample(problem, count, num_levels=4, seed=seed)
    return uniforms, inputs.physical(special.ndtri(uniforms))


def _unit_problem(names: Names) -> dict[str, Any]:
    return {"num_vars": len(names), "names": list(names), "bounds": [[0.0, 1.0]] * len(names)}


def salib_measures(
    method: str, uniforms: Array, outputs: Array, names: Names, *, seed: int
) -> list[Estimate]:
    """SALib's measure of every input from uniform rows (n, d) and outputs (n,).

    mu* of Morris, from rows of `morris_rows`, has the interval of the independent trajectories by
    Student's law; for delta and the median of PAWN nobody knows one that covers (delta of an input
    that does nothing comes out at 0.065), and they have none.
    """
    shown = f"SALib {method}"
    d = len(names)
    if not np.isfinite(outputs).all():
        # SALib answers zeros, without a word, where one output is not finite
        return [
            absent("outputs that are not finite: SALib would answer zeros", shown, outputs.size)
        ] * d
    if method == "morris":
        # in each step of a trajectory (d + 1, d) one input moves
        steps = np.diff(uniforms.reshape(-1, d + 1, d), axis=1)
        rises = np.diff(outputs.reshape(-1, d + 1), axis=1)
        effects = np.abs((rises[:, :, None] / np.where(steps == 0.0, np.inf, steps)).sum(axis=1))
        return [from_replicates(column, f"{shown}, mu*", outputs.size) for column in effects.T]
    from SALib.analyze import delta, pawn

    problem = _unit_problem(names)
    seed = seed or 1  # SALib takes 0 for no seed
    y = (outputs - outputs.mean()) / (outputs.std() or 1.0)
    if method == "delta":
        answers = delta.analyze(problem, uniforms, y, num_resamples=2, seed=seed)
        measures = answers.get("delta", answers.get("delta_balanced"))
    else:
        measures = pawn.analyze(problem, uniforms, y, S=10, seed=seed)["median"]
    # the measure alone: no interval is known
    return [
        Estimate(value=float(value), method=shown, evaluations=outputs.size) for value in measures
    ]
