"""Fragility: the probability of exceedance over the free number, and the free number at a
probability.

The same points serve every value, so that the curve is smooth; each replicate has its own curve,
and their spread is the interval.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from uqsphere.arrays import Array, Flags, frozen
from uqsphere.errors import UsageError, whole
from uqsphere.models.model import Model
from uqsphere.quantities import lookup
from uqsphere.results.answers import Rows, estimate_row, number_row
from uqsphere.study import VALUES, Limit, Study
from uqsphere.uq import Estimate
from uqsphere.uq.curve import Fragility
from uqsphere.uq.curve import fragility as fragility_of
from uqsphere.uq.estimate import REPLICATES, absent, carriers, count_bound, lost_share

from .design import Design
from .line import Line, evaluated_at, exceedance, line_of
from .tables import TOO_FEW, Tables, too_few

METHOD = "the same points at every value"


def fragility(tables: Tables) -> Rows:
    """Curves and margins of every limit and failure mode."""
    design = tables.design
    margins = design.study.margins
    if margins is None:
        return
    unit = lookup(design.free_quantity).unit
    # those of the sample where the line moves no row
    along = sum(sample.size for sample in tables.line.values())
    runs = tables.predicted_from or along or tables.runs
    for limit in design.judged.limits:
        subject = limit.subject
        if margins.limit is None and not tables.line:
            unknown = absent(tables.without_line, METHOD, runs)
            yield estimate_row(subject, "margin", unknown, limit.allowable, unit=unit, runs=runs)
            continue
        fitted = curve_of(tables, limit)
        for *row, low_unseen, high_unseen in fitted.curve:
            yield number_row(
                subject,
                "curve",
                *row,
                low_unseen=low_unseen,
                high_unseen=high_unseen,
                method=METHOD,
                runs=runs,
            )
        for p, estimate in fitted.values.items():
            yield estimate_row(subject, "margin", estimate, p, unit=unit, runs=runs)


def curve_of(tables: Tables, limit: Limit, targets: Sequence[float] = ()) -> Fragility:
    """The curve of a limit, with the free number at the study's probabilities and the target, or at
    others; absent where too few rows carry a small probability, of which there is only a bound.
    """
    fitted, line, carrying = _fitted(tables, limit, targets)
    if line.compared is not None:  # its rows tell the ends
        return fitted
    values = dict(fitted.values)
    for p, estimate in fitted.values.items():
        if estimate.value is not None:
            at = int(np.searchsorted(line.values, estimate.value))
            if too_few(min(p, 1.0 - p), min(carrying[max(at - 1, 0) : at + 1])):
                values[p] = absent(TOO_FEW, estimate.method, estimate.evaluations)
    curve = np.array(fitted.curve)
    _, p, *ends = curve.T
    bounds = [count_bound(REPLICATES * count) for count in line.counts]
    for low, high in (ends[:2], ends[2:]):
        rare, most = _bounds(p, high, carrying, bounds)
        sure, least = _bounds(1.0 - p, 1.0 - low, carrying, bounds)
        low[:] = np.where(rare, 0.0, np.where(sure, 1.0 - least, low))
        high[:] = np.where(sure, 1.0, np.where(rare, most, high))
    return replace(fitted, curve=curve.tolist(), values=values)


def _bounds(
    probability: Array, high: Array, carrying: Sequence[float], bounds: Sequence[float]
) -> tuple[Flags, Array]:
    """Which probabilities (K,) of a curve are small and carried by too few rows, and the upper ends
    (K,) with theirs: that of a count of none, or what the next value towards larger ones leaves.
    """
    few = np.array([*map(too_few, probability, carrying)])
    high = high.copy()
    order: Iterable[int] = range(len(high))
    if probability[-1] >= probability[0]:
        order = reversed(range(len(high)))
    most = math.inf
    for k in order:
        if few[k]:
            high[k] = max(high[k], min(bounds[k], most))
        most = high[k]
    return few, high


def _fitted(
    tables: Tables, limit: Limit, targets: Sequence[float]
) -> tuple[Fragility, Line, Sequence[float]]:
    """The same however few rows carry it, with the line and how many carry it at each value."""
    margins = tables.design.study.margins
    line = line_of(tables, tables.sample.count)
    assert margins
    assert line
    means, carrying, lost = _along(line, limit)
    ends = None
    if line.compared is not None:
        ends = line.ends_by_rows(limit, means[0])

    def fitted(shift: Array | float = 0.0) -> Fragility:
        return fragility_of(
            np.array(line.values),
            np.clip(means + shift, 0.0, 1.0),
            targets or sorted({*margins.for_probability, limit.allowable}),
            samples=line.counts,
            carrying=carrying,
            ends=ends,
        )

    curve = fitted()
    if lost.any():
        # between what it is if as many as may fail had all been on either side
        curve = curve.allowing([fitted(-lost[:, None]), fitted(lost[:, None])])
    return curve, line, carrying


def _along(line: Line, limit: Limit) -> tuple[Array, Sequence[float], Array]:
    """Mean probabilities (3, K, R) of exceedance of a limit at each value of a line: as computed,
    and where as few and as many as possible exceed of the rows whose record ended too early or that
    failed.  Beside them how many rows carry them, or their complement if fewer do (K,), and the
    shares (K,) that may fail beyond those that are counted.
    """
    means = []
    lost = []
    carrying = []
    for value, sample in line.samples.items():
        state = replace(line, samples={value: sample}).state(limit)
        exceeded, held = state.tails()
        carrying.append(min(carriers(exceeded), carriers(held)))
        mean = exceeded.sum(axis=1) / np.maximum((~state.broken).sum(axis=1), 1)
        least = most = mean
        counted = state.on_failure == "bound"
        if counted or state.late.any():
            least, most = (
                np.nanmean(exceedance(state, survive), axis=1) for survive in (False, True)
            )
        means.append([mean, least, most])
        lost.append(lost_share(state.broken) - counted * state.broken.mean())
    return np.moveaxis(np.array(means), 1, 0), carrying, np.array(lost)


def margin_and_scale(tables: Tables, limit: Limit) -> tuple[Estimate, float | None]:
    """The free number at the target, and half of what the curve takes from 16 to 84 %: what its
    accuracy is held to.
    """
    fitted, *_ = _fitted(tables, limit, sorted({0.16, limit.allowable, 0.84}))
    values = fitted.values
    margin, low, high = (values[p] for p in (limit.allowable, 0.16, 0.84))
    if low.value is None or high.value is None or low.value == high.value:
        return margin, None
    return margin, 0.5 * abs(high.value - low.value)


# --- curves without a whole run -------------------------------------------------------------------


@frozen
class Curves:
    """What a study answers at values (m,) of its free number [SI].

    outputs : (m, n) of each quantity; NaN without an answer.
    limits : probability of exceeding the strength of each limit, with the values at the margins'
        probabilities.
    failed : (m,) share of samples without an answer.
    """

    values: Array
    outputs: Mapping[str, Array]
    limits: Mapping[str, Fragility]
    failed: Array


def fragility_curves(study: Study, *, rows: int = 1024, values: int = VALUES) -> Curves:
    """Fragility curves over the free number of a study's margins, as its run computes them.

    The strengths of tests, their size effect and the dependence of the inputs count as in
    `uqsphere.run`.  Failure modes with a strength of the library, at the middle of its range, are
    among the limits as "core tension (assumed)" unless analysis.failure_modes is "given"; those
    that are damage, not fracture, are left out.

    Parameters
    ----------
    study : an impact scene with `[margins]`
    rows : samples at every value, at least 16
    values : values of the free number

    Raises UsageError for a study without such margins, or a black box; TooManyFailures.
    """
    margins = study.moving
    if study.black_box or margins is None:
        raise UsageError("fragility curves need an impact scene whose [margins] vary one number")
    design = Design.of(study)
    count = max(round(whole(rows, "rows", 1) / REPLICATES), 2)
    counts = dict.fromkeys(margins.grid(whole(values, "values", 2)), count)
    with Model(design.judged) as model:
        line = evaluated_at(design, model, {}, counts)
    tables = Tables(design=design, sample=next(iter(line.values())), line=line)
    samples = [*line.values()]
    outputs = {}
    for name in design.columns:
        outputs[name] = np.stack([sample.outputs(name) for sample in samples])
    asked = margins.for_probability
    limits = [*study.limits, *(mode.limit for mode in design.modes if mode.counts)]
    return Curves(
        values=np.array([*line]),
        outputs=outputs,
        limits={limit.name: curve_of(tables, limit, asked) for limit in limits},
        failed=np.array([sample.failed.mean() for sample in samples]),
    )
