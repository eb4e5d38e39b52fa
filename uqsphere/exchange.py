"""A study's inputs for other tools, and runs of rows that were answered elsewhere.

>>> import uqsphere
>>> uniform = {"dist": "uniform", "lower": 0.0, "upper": 1.0}
>>> study = uqsphere.Study(inputs={"x": uniform}, outputs="y")
>>> rows = uqsphere.design(study, 64)
>>> run = uqsphere.analyse(study, rows.assign(y=rows["x"] ** 2))
>>> run.sobol("y")["first"].round(3).tolist()
[1.0]
"""

from pathlib import Path
from typing import TYPE_CHECKING

from uqsphere.arrays import Array, special
from uqsphere.errors import whole
from uqsphere.study import Study
from uqsphere.uq import Joint, interop, random_generator, sobol_points

if TYPE_CHECKING:
    from chaospy import Distribution
    from pandas import DataFrame

    from uqsphere.results import Run

__all__ = ["analyse", "design", "joint", "sample", "to_salib"]


def _inputs(study: Study) -> Joint:
    """The random inputs with their dependence, without strengths and model factors."""
    return study.inputs().only(tuple(study.random))


def _table(laws: Joint, normals: Array) -> "DataFrame":
    from pandas import DataFrame

    return DataFrame(laws.physical(normals), columns=laws.names)


def sample(study: Study, count: int) -> "DataFrame":
    """Independent rows of every random number of a study, strengths too.

    Parameters
    ----------
    study : of `load_study` or `Study`
    count : rows

    Returns
    -------
    One column for each number [SI], (count, d); the same for the same seed of the study.
    """
    laws = study.inputs()
    rng = random_generator(study.seed, "study sample")
    return _table(laws, rng.standard_normal((whole(count, "count"), len(laws.names))))


def design(study: Study, count: int) -> "DataFrame":
    """Rows of the random inputs for a solver elsewhere: points of a scrambled Sobol' sequence.

    Parameters
    ----------
    study : of `load_study` or `Study`
    count : rows; more of them continue fewer

    Returns
    -------
    One column for each input [SI], (count, d).  Their answers, in columns by the names of the
    outputs, are for `analyse`.
    """
    laws = _inputs(study)
    size = len(laws.names)
    points = sobol_points(size, whole(count, "count"), seed=study.seed, task="slow")
    return _table(laws, special.ndtri(points))


def analyse(study: Study, frame: "DataFrame", *, out: str | Path | None = None) -> "Run":
    """The run of a black-box study whose rows were answered elsewhere: every analysis, without
    calling a model.

    An event rarer than 3 in the number of rows is in no interval, and the answers say so.

    Parameters
    ----------
    study : a black-box study
    frame : random inputs and outputs by their names, 16 rows or more drawn as the study says
        (`design`, `sample`, measurements); a row without an answer is nan, and counts as
        `analysis.on_failure` says
    out : folder for the results; None keeps them in memory

    Raises
    ------
    UsageError
        For missing columns, too few rows, and rows that do not follow the study's distributions.
    """
    from uqsphere.propagation import run

    return run(study, rows=frame, out=out)


def to_salib(study: Study, count: int = 1024, *, second: bool = False) -> interop.SalibDesign:
    """The study's own design of Sobol' indices as a problem and rows of SALib.

    Parameters
    ----------
    study : of `load_study` or `Study`, with inputs that do not depend on each other
    count : base points N
    second : with the rows of second-order indices

    Returns
    -------
    `problem`, and `rows` [SI] (N (d + 2), d), or (N (2 d + 2), d), in the order that
    `SALib.analyze.sobol.analyze` takes.

    Raises
    ------
    UsageError
        For inputs that depend on each other.
    """
    return interop.to_salib(
        _inputs(study), whole(count, "count", 1), second=second, seed=study.seed
    )


def joint(study: Study) -> "Distribution":
    """The joint distribution of the random inputs [SI] as chaospy has it.

    Distributions that chaospy does not have keep the functions of this package.

    Raises
    ------
    UsageError
        For inputs that a Student t copula ties.
    """
    return interop.joint_to_chaospy(_inputs(study))
