"""Sobol' indices by pick and freeze: first, total, second order and groups, for all replicates and inputs at once.

Write a, b, ab, ba for the outputs on the blocks A, B, AB_j, BA_j of a design (`uqsphere.uq.blocks`), about their common
mean, and V for their variance.  Every estimator is a ratio of two means over the points of a replicate.  The value is
the ratio of the means over all replicates, and the interval that of the linearised ratio, Student's with R - 1 degrees
of freedom: the replicates' own ratios would each carry the bias of a ratio of few points.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from typing import Final, TypeAlias

import numpy as np

from uqsphere.uq.blocks import Blocks, Outputs
from uqsphere.uq.estimates import Estimate, absent, from_replicates
from uqsphere.uq.families import Array

__all__ = ["ESTIMATORS", "LARGE", "METHOD", "SampledIndices", "choice_text", "index_estimates", "sampled_indices"]

#: Numerators and denominators of replicates, (R, m) each, of m indices that are their ratios.
Ratio: TypeAlias = tuple[Array, Array]

#: Inputs whose total index is above this have their indices read off the correlation of pairs.
LARGE: Final = 0.5

METHOD: Final = "pick and freeze"

#: What is left of a difference of two sums that cancel, over V.
_ROUNDING: Final = 1e-15
_NO_SCATTER: Final = "the output does not vary"


# --- the estimators: (R, m) numerators and denominators from the outputs of blocks -------------------------


def _mean(rows: Array) -> Array:
    return np.asarray(rows.mean(axis=1))


def _variance(a: Array, b: Array, like: Array) -> Array:
    """V of every replicate about the common mean, repeated for as many indices as `like` has blocks."""
    return np.repeat(0.5 * _mean(a * a + b * b), like.shape[2], axis=1)


def _saltelli_first(a: Array, b: Array, ab: Array) -> Ratio:
    """<b (ab - a)> / V (Saltelli et al., Comput. Phys. Commun. 181, 2010, 259, table 2 (b))."""
    return _mean(b * (ab - a)), _variance(a, b, ab)


def _jansen_first(a: Array, b: Array, ab: Array) -> Ratio:
    """1 - <(b - ab)²> / 2V (Jansen, Comput. Phys. Commun. 117, 1999, 35; Saltelli's table 2 (c))."""
    v = _variance(a, b, ab)
    return v - 0.5 * _mean((b - ab) ** 2), v


def _jansen_total(a: Array, b: Array, ab: Array) -> Ratio:
    """<(a - ab)²> / 2V (Jansen 1999; Saltelli's table 2 (f))."""
    return 0.5 * _mean((a - ab) ** 2), _variance(a, b, ab)


def _pairs(y: Array, z: Array) -> Ratio:
    """<y z> / <(y² + z²)/2> about the common mean of the pair, for runs that share some inputs.

    Janon, Klein, Lagnoux, Nodet, Prieur, ESAIM: Prob. Stat. 18, 2014, 342, equation (6).  Numerator and
    denominator share their noise: little of it is left where the index is near 1.
    """
    mean = 0.5 * (y.mean(axis=(0, 1)) + z.mean(axis=(0, 1)))
    y, z = y - mean, z - mean
    return _mean(y * z), 0.5 * _mean(y * y + z * z)


def _janon_first(a: Array, b: Array, ab: Array) -> Ratio:
    return _pairs(b, ab)


def _janon_total(a: Array, b: Array, ab: Array) -> Ratio:
    product, square = _pairs(a, ab)
    return square - product, square


def _martinez(y: Array, z: Array) -> Ratio:
    """Pearson's correlation of pairs, each about its own mean and in its own scale.

    J.-M. Martinez, GdR MASCOT-NUM, 2011; the statistic is that of Baudin et al., arXiv 1606.01746.
    """
    y, z = y - y.mean(axis=(0, 1)), z - z.mean(axis=(0, 1))
    vy, vz = _mean(y * y), _mean(z * z)
    # The root of the product of two means, linearised about their pooled values, is a mean over replicates again.
    py, pz = vy.mean(axis=0), vz.mean(axis=0)
    root = np.sqrt(py * pz)
    with np.errstate(invalid="ignore", divide="ignore"):
        return _mean(y * z), np.where(root > 0.0, 0.5 * root * (vy / py + vz / pz), 0.0)


def _martinez_first(a: Array, b: Array, ab: Array) -> Ratio:
    return _martinez(b, ab)


def _martinez_total(a: Array, b: Array, ab: Array) -> Ratio:
    product, root = _martinez(a, ab)
    return root - product, root


def _azzini_scale(a: Array, b: Array, ab: Array, ba: Array) -> Array:
    return _mean((a - b) ** 2 + (ba - ab) ** 2)


def _azzini_first(a: Array, b: Array, ab: Array, ba: Array) -> Ratio:
    """2 <(ba - b)(a - ab)> / <(a - b)² + (ba - ab)²> (Azzini, Mara, Rosati, MethodsX 8, 2021, 101201)."""
    return 2.0 * _mean((ba - b) * (a - ab)), _azzini_scale(a, b, ab, ba)


def _azzini_total(a: Array, b: Array, ab: Array, ba: Array) -> Ratio:
    """<(b - ba)² + (a - ab)²> / <(a - b)² + (ba - ab)²> (the same)."""
    return _mean((b - ba) ** 2 + (a - ab) ** 2), _azzini_scale(a, b, ab, ba)


def _owen_first(a: Array, b: Array, ac: Array, ba: Array) -> Ratio:
    """<(a - ac)(ba - b)> / V: "correlation 2" of Owen (ACM Trans. Model. Comput. Simul. 23, 2013, article 11).

    Both factors vanish with the effect of the input, so that the error of a small index is small beside it.
    """
    return _mean((a - ac) * (ba - b)), _variance(a, b, ba)


#: Estimator -> order -> ratio of what it needs: a, b, ab; "azzini_rosati" also ba; "owen" a, b, ac, ba.
ESTIMATORS: Final[Mapping[str, Mapping[str, Callable[..., Ratio]]]] = {
    "saltelli": {"first": _saltelli_first, "total": _jansen_total},
    "jansen": {"first": _jansen_first, "total": _jansen_total},
    "janon_monod": {"first": _janon_first, "total": _janon_total},
    "martinez": {"first": _martinez_first, "total": _martinez_total},
    "azzini_rosati": {"first": _azzini_first, "total": _azzini_total},
    "owen": {"first": _owen_first},
}

_SHOWN: Final = {
    "saltelli": "Saltelli 2010",
    "jansen": "Jansen",
    "janon_monod": "correlation of pairs",
    "martinez": "Martinez",
    "azzini_rosati": "Azzini and Rosati",
    "owen": "Owen's correlation 2",
}


def _arguments(outputs: Outputs, name: str) -> tuple[Array, ...]:
    if name == "owen":
        if outputs.ac is None or outputs.ba is None:
            raise ValueError("Owen's estimator needs the third half: Blocks(second=True, third=True)")
        return outputs.a, outputs.b, outputs.ac, outputs.ba
    if name == "azzini_rosati":
        if outputs.ba is None:
            raise ValueError("the estimator of Azzini and Rosati needs the blocks BA: Blocks(second=True)")
        return outputs.a, outputs.b, outputs.ab, outputs.ba
    return outputs.a, outputs.b, outputs.ab


def _estimates(ratio: Ratio, method: str, evaluations: int) -> list[Estimate]:
    """Estimates of m indices: the pooled ratio, and the spread of numerator less index times denominator."""
    numerator, denominator = ratio
    scale = denominator.mean(axis=0)
    found = []
    for j in range(numerator.shape[1]):
        if not scale[j] > 0.0:
            found.append(absent(_NO_SCATTER, method, evaluations))
            continue
        index = float(numerator[:, j].mean() / scale[j])
        deviation = (numerator[:, j] - index * denominator[:, j]) / scale[j]
        floor = _ROUNDING if index != 0.0 else 0.0
        found.append(from_replicates(index + deviation, method, evaluations, index, floor=floor))
    return found


def _method(name: str, order: str) -> str:
    # Saltelli's paper takes Jansen's for the total indices.
    shown = "Jansen" if (name, order) == ("saltelli", "total") else _SHOWN[name]
    return f"{METHOD}, {shown}"


def _by(outputs: Outputs, name: str, order: str, arguments: tuple[Array, ...]) -> list[Estimate]:
    """One order by one estimator."""
    return _estimates(ESTIMATORS[name][order](*arguments), _method(name, order), outputs.evaluations)


def _nothing(count: int, outputs: Outputs) -> list[Estimate]:
    return [absent(_NO_SCATTER, METHOD, outputs.evaluations)] * count


def index_estimates(outputs: Array, blocks: Blocks, estimator: str) -> dict[str, list[Estimate]]:
    """First and total indices {"first": [...], "total": [...]} of every input by one estimator of `ESTIMATORS`.

    Parameters
    ----------
    outputs : (R, N, blocks.count) array
        The model on the blocks of R independent replicates.
    blocks : Blocks
    estimator : name; "owen" has first indices alone

    An output that does not vary is answered by absent estimates.  Nothing is clipped.

    Raises
    ------
    ValueError
        For outputs that are not finite or of another shape, and blocks that the estimator lacks.
    """
    y = blocks.split(outputs)
    arguments = _arguments(y, estimator)
    if not y.varies:
        return {order: _nothing(blocks.inputs_count, y) for order in ESTIMATORS[estimator]}
    return {order: _by(y, estimator, order, arguments) for order in ESTIMATORS[estimator]}


# --- the answer of a design ---------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class SampledIndices:
    """Indices of one output.

    `first` and `total` are in the order of the inputs, `second` by the pair (i, j), i < j, of their numbers;
    `group_first` (the closed index of the group: all that its inputs do, alone and with each other) and
    `group_total` are in the order of the groups.  `large` are the inputs that were read off pairs, `text` says
    which estimator was taken, and why.
    """

    first: list[Estimate]
    total: list[Estimate]
    second: dict[tuple[int, int], Estimate] = field(default_factory=dict)
    group_first: list[Estimate] = field(default_factory=list)
    group_total: list[Estimate] = field(default_factory=list)
    large: tuple[int, ...] = ()
    text: str = ""


def sampled_indices(outputs: Array, blocks: Blocks) -> SampledIndices:
    """Every index that the blocks allow, each by the estimator that suits its size.

    With the blocks of second order all first and total indices are those of Azzini and Rosati.  Without, an input
    whose total index (Jansen's) is above `LARGE` has both of its indices from the correlation of pairs, every other
    its first index from Saltelli 2010 and its total index from Jansen.  The size of an index decides and never the
    width of an interval: to take the narrower of two intervals would choose those that are narrow by chance.

    Parameters, absent answers and ValueError as of `index_estimates`.
    """
    y = blocks.split(outputs)
    d, groups = blocks.inputs_count, len(blocks.groups)
    if not y.varies:
        return SampledIndices(
            first=_nothing(d, y),
            total=_nothing(d, y),
            second=dict.fromkeys(combinations(range(d), 2), _nothing(1, y)[0]) if blocks.second else {},
            group_first=_nothing(groups, y),
            group_total=_nothing(groups, y),
            text=f"No index is given: {_NO_SCATTER}.",
        )
    large: tuple[int, ...] = ()
    if y.ba is not None:
        arguments = _arguments(y, "azzini_rosati")
        first, total = (_by(y, "azzini_rosati", order, arguments) for order in ("first", "total"))
    else:
        first, total, large = _by_size(y, y.ab)
    group_first, group_total, _ = _by_size(y, y.groups) if groups else ([], [], ())
    return SampledIndices(
        first=first,
        total=total,
        second=_second_order(y) if y.ba is not None else {},
        group_first=group_first,
        group_total=group_total,
        large=large,
        text=choice_text(blocks, len(large)),
    )


def _by_size(outputs: Outputs, mixed: Array) -> tuple[list[Estimate], list[Estimate], tuple[int, ...]]:
    """First and total indices from the blocks AB of inputs or groups, and the numbers of those that are large."""
    arguments = outputs.a, outputs.b, mixed
    plain = {order: _by(outputs, "saltelli", order, arguments) for order in ("first", "total")}
    large = tuple(j for j, e in enumerate(plain["total"]) if e.value is not None and e.value > LARGE)
    if large:
        few = outputs.a, outputs.b, mixed[:, :, list(large)]
        for order, row in plain.items():
            for j, estimate in zip(large, _by(outputs, "janon_monod", order, few), strict=True):
                row[j] = estimate
    return plain["first"], plain["total"], large


def _second_order(outputs: Outputs) -> dict[tuple[int, int], Estimate]:
    """Interaction indices S_ij of all pairs, <(ba_i - b)(ab_j - a)> / V and the same with i and j exchanged.

    BA_i and AB_j share the columns i and j, so that <ba_i ab_j> is the closed index of the pair (Saltelli, Comput.
    Phys. Commun. 145, 2002, 280, theorem 2); <ba_i a> and <b ab_j> are the first indices, which the product takes off
    with the noise that they share.
    """
    if outputs.ba is None:
        raise ValueError("second order needs the blocks BA: Blocks(second=True)")
    ba, ab = outputs.ba - outputs.b, outputs.ab - outputs.a
    _, n, d = ba.shape
    pairs = list(combinations(range(d), 2))
    if not pairs:
        return {}
    products = np.matmul(ba.transpose(0, 2, 1), ab) / n
    rows, columns = np.array(pairs).T
    numerator = 0.5 * (products[:, rows, columns] + products[:, columns, rows])
    v = 0.5 * _mean(outputs.a**2 + outputs.b**2)
    ratio = numerator, np.repeat(v, len(pairs), axis=1)
    return dict(zip(pairs, _estimates(ratio, f"{METHOD}, second order", outputs.evaluations), strict=True))


def choice_text(blocks: Blocks, large: int) -> str:
    """Which estimators were taken and why, for the report.

    >>> choice_text(Blocks(inputs_count=3, second=True), 0)[:40]
    'All indices by Azzini and Rosati, whose '
    """
    d = blocks.inputs_count
    if blocks.second:
        return (
            "All indices by Azzini and Rosati, whose blocks second order needs anyway "
            f"({2 * d + 2} evaluations for a base point): their error falls with the size of the index."
        )
    small = "Saltelli 2010 for first and Jansen for total indices: their errors fall with the total index."
    if large == 0:
        return f"{small} No total index is above {LARGE:g}."
    inputs, verb = ("input has", "It is") if large == 1 else ("inputs have", "They are")
    return (
        f"{small} {large} of {d} {inputs} a total index above {LARGE:g}. {verb} read off the correlation of pairs of "
        "runs, whose error falls as an index nears 1."
    )
