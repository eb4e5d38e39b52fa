"""Sobol' indices by pick and freeze: first, total, second order and groups, for all replicates and inputs at once.

A design has two independent halves A and B (N, d) and blocks mixed from them: AB_u is A with the columns u of B,
BA_u is B with the columns u of A.

Write a, b, ab, ba for the outputs on the blocks A, B, AB_j, BA_j, about their common mean, and V for their variance.
Every estimator is a ratio of two means over the points of a replicate.  The value is the ratio of the means over all
replicates, and the interval that of the linearised ratio: the replicates' own ratios would each carry the bias of a
ratio of few points.  Student's degrees of freedom are those of the replicates and of the points that carry the answer
(`uqsphere.uq.estimate.freedom`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.estimate import (
    Estimate,
    Why,
    absent,
    added,
    around,
    corrected,
    freedom,
    ratio_of_means,
    spread,
    student,
)
from uqsphere.uq.expansion import Chaos, germ_points, predict
from uqsphere.uq.points import sobol_points


@dataclass(frozen=True, kw_only=True)
class Blocks:
    """The blocks of a design: A, AB_1 ... AB_d, B, then BA_1 ... BA_d (`second`), AB_g of groups.

    Evaluations for each base point: d + 2, and d more for second order, one more for each group.

    >>> Blocks(inputs_count=3).count, Blocks(inputs_count=3, second=True, groups=((0, 1),)).count
    (5, 9)
    """

    inputs_count: int
    second: bool = False
    groups: tuple[tuple[int, ...], ...] = ()

    def __post_init__(self) -> None:
        for group in self.groups:
            if not group or len(set(group)) != len(group) or not all(0 <= k < self.inputs_count for k in group):
                raise ValueError(f"a group names inputs from 0 to {self.inputs_count - 1}, each once; found {group}")

    @property
    def count(self) -> int:
        """Evaluations for each base point."""
        d = self.inputs_count
        return d + 2 + d * self.second + len(self.groups)

    def mix(self, a: Array, b: Array) -> Array:
        """Blocks (N, count, d) of halves A, B, (N, d) each; of uniforms or of what they are mapped to.

        >>> rows = Blocks(inputs_count=2, second=True).mix(np.array([[1.0, 2.0]]), np.array([[3.0, 4.0]]))
        >>> rows[0].tolist()
        [[1.0, 2.0], [3.0, 2.0], [1.0, 4.0], [3.0, 4.0], [1.0, 4.0], [3.0, 2.0]]
        """
        d = self.inputs_count
        if a.shape != b.shape or a.shape[1] != d:
            raise ValueError(f"two halves (N, {d}) are due, found {a.shape} and {b.shape}")
        inputs = np.arange(d)
        blocks = np.repeat(a[:, None, :], self.count, axis=1)
        blocks[:, inputs + 1, inputs] = b
        blocks[:, d + 1] = b
        at = d + 2
        if self.second:
            blocks[:, at : at + d] = b[:, None, :]
            blocks[:, at + inputs, inputs] = a
            at += d
        for group in self.groups:
            blocks[:, at, list(group)] = b[:, list(group)]
            at += 1
        return blocks

    def split(self, outputs: Array) -> Outputs:
        """The outputs (R, N, count) by block, about their common mean; refuses what is not finite."""
        d = self.inputs_count
        outputs = np.asarray(outputs, dtype=float)
        if outputs.ndim != 3 or outputs.shape[2] != self.count or outputs.shape[1] < 2 or outputs.shape[0] < 2:
            raise ValueError(f"outputs must have shape (R, N, {self.count}), R >= 2, N >= 2; found {outputs.shape}")
        if not np.isfinite(outputs).all():
            bad = int((~np.isfinite(outputs)).sum())
            raise ValueError(f"{bad} outputs are not finite: indices of them mean nothing; drop those rows first")
        base = outputs[:, :, [0, d + 1]]
        centre, largest = float(base.mean()), float(np.abs(base).max())
        varies = bool(np.ptp(base) > 1e-14 * largest)
        # Scaled by a power of two, which is exact, so that outputs of 1e300 have squares.
        scale = 2.0 ** -np.frexp(np.abs(base - centre).max())[1] if varies and np.isfinite(centre) else 1.0
        y = (outputs - centre) * scale
        at = d + 2
        ba = y[:, :, at : at + d] if self.second else None
        at += d * self.second
        return Outputs(a=y[:, :, :1], ab=y[:, :, 1 : d + 1], b=y[:, :, d + 1 : d + 2], ba=ba, groups=y[:, :, at:],
                       varies=varies, evaluations=outputs.size)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Outputs:
    """Centred outputs by block: a, b (R, N, 1), ab, ba (R, N, d) and groups (R, N, G)."""

    a: Array
    b: Array
    ab: Array
    ba: Array | None
    groups: Array
    varies: bool
    evaluations: int

    def points(self, replicate: int) -> Outputs:
        """The points of one replicate, each as if it were a replicate."""
        parts = {name: getattr(self, name)[replicate][:, None] for name in ("a", "b", "ab", "groups")}
        return replace(self, **parts, ba=None if self.ba is None else self.ba[replicate][:, None])


def uniform_halves(
    blocks: Blocks, *, count: int, seed: int, task: str, replicate: int, start: int = 0
) -> tuple[Array, Array]:
    """Uniform halves A, B, (count, d) each, of one replicate; `start` continues the same design.

    They are the columns of one scrambled Sobol' sequence, so that both together are evenly spread.
    """
    d = blocks.inputs_count
    points = sobol_points(dimension=2 * d, count=count, start=start, seed=seed, task=task, replicate=replicate)
    return points[:, :d], points[:, d:]


# --- estimators -----------------------------------------------------------------------------------

#: Numerators and denominators of replicates, (R, m) each, of m indices that are their ratios.
Ratio: TypeAlias = tuple[Array, Array]


def block_mean(rows: Array) -> Array:
    """Means (R, m) over the points of (R, N, m)."""
    return np.asarray(rows.mean(axis=1))


def _variance(a: Array, b: Array, like: Array) -> Array:
    """V of every replicate about the common mean, repeated for as many indices as `like` has blocks."""
    return np.repeat(0.5 * block_mean(a * a + b * b), like.shape[2], axis=1)


def _saltelli_first(a: Array, b: Array, ab: Array) -> Ratio:
    """<b (ab - a)> / V (Saltelli et al., Comput. Phys. Commun. 181, 2010, 259, table 2 (b))."""
    return block_mean(b * (ab - a)), _variance(a, b, ab)


def jansen_total(a: Array, b: Array, ab: Array) -> Ratio:
    """<(a - ab)²> / 2V (Jansen 1999; Saltelli's table 2 (f))."""
    return 0.5 * block_mean((a - ab) ** 2), _variance(a, b, ab)


def _pairs(y: Array, z: Array) -> Ratio:
    """<y z> / <(y² + z²)/2> about the common mean of the pair, for runs that share some inputs.

    Janon, Klein, Lagnoux, Nodet, Prieur, ESAIM: Prob. Stat. 18, 2014, 342, equation (6).  Numerator and
    denominator share their noise: little of it is left where the index is near 1.
    """
    mean = 0.5 * (y.mean(axis=(0, 1)) + z.mean(axis=(0, 1)))
    y, z = y - mean, z - mean
    return block_mean(y * z), 0.5 * block_mean(y * y + z * z)


def _janon_first(a: Array, b: Array, ab: Array) -> Ratio:
    return _pairs(b, ab)


def _janon_total(a: Array, b: Array, ab: Array) -> Ratio:
    product, square = _pairs(a, ab)
    return square - product, square


def _azzini_scale(a: Array, b: Array, ab: Array, ba: Array) -> Array:
    return block_mean((a - b) ** 2 + (ba - ab) ** 2)


def _azzini_first(a: Array, b: Array, ab: Array, ba: Array) -> Ratio:
    """2 <(ba - b)(a - ab)> / <(a - b)² + (ba - ab)²> (Azzini, Mara, Rosati, MethodsX 8, 2021, 101201)."""
    return 2.0 * block_mean((ba - b) * (a - ab)), _azzini_scale(a, b, ab, ba)


def _azzini_total(a: Array, b: Array, ab: Array, ba: Array) -> Ratio:
    """<(b - ba)² + (a - ab)²> / <(a - b)² + (ba - ab)²> (the same)."""
    return block_mean((b - ba) ** 2 + (a - ab) ** 2), _azzini_scale(a, b, ab, ba)


#: Estimator -> order -> ratio of what it needs: a, b, ab; "azzini_rosati" also ba.
ESTIMATORS: Final[Mapping[str, Mapping[str, Callable[..., Ratio]]]] = {
    "saltelli": {"first": _saltelli_first, "total": jansen_total},
    "janon_monod": {"first": _janon_first, "total": _janon_total},
    "azzini_rosati": {"first": _azzini_first, "total": _azzini_total},
}


# --- indices of a design --------------------------------------------------------------------------

#: Inputs whose total index is above this have their indices read off the correlation of pairs.
LARGE: Final = 0.5

METHOD: Final = "pick and freeze"

#: What is left of a difference of two sums that cancel, over V.
_ROUNDING: Final = 1e-15
_CONTROLLED: Final = " A surrogate, whose indices are known exactly, is the control variate of each."
_TABULATED: Final = " A table of the model at many more points is the control variate of each."
#: answers (R, m) of the replicates with the method of each, and the numbers of the inputs and groups read off pairs
_Answer: TypeAlias = tuple[Array, list[str]]
_Chosen: TypeAlias = tuple[tuple[int, ...], tuple[int, ...]]
_NO_SCATTER: Final = "the output does not vary"


_SHOWN: Final = {
    "saltelli": "Saltelli 2010",
    "janon_monod": "correlation of pairs",
    "azzini_rosati": "Azzini and Rosati",
}


def _rows(ratio: Ratio) -> Array:
    """Answers (R, m) of the replicates: the pooled ratio and the linearised deviation from it; nan where V is 0."""
    index, off = ratio_of_means(*ratio)
    return np.asarray(index + off)


def _estimate(rows: Array, method: str, carriers: float, evaluations: int, floor: float = _ROUNDING) -> Estimate:
    """An index from the answers (R,) of replicates and how many points carry it; no error is below `floor`."""
    if not np.isfinite(rows).all():
        return absent(_NO_SCATTER, method, evaluations)
    value, error = float(rows.mean()), max(spread(rows), floor) if np.any(rows) else 0.0
    half = student(1.0 + float(freedom(len(rows), np.asarray(carriers)))) * error
    return around(value, half, error, method, evaluations)


def _method(name: str, order: str) -> str:
    # Saltelli's paper takes Jansen's for the total indices.
    shown = "Jansen" if (name, order) == ("saltelli", "total") else _SHOWN[name]
    return f"{METHOD}, {shown}"


# --- the answer of a design ---------------------------------------------------------------------------------


#: an index whose half-width is above this is withheld: the interval spans the whole range
WORTHLESS: Final = 0.5


def believable(row: Iterable[Estimate]) -> list[Estimate]:
    """Indices, without those whose interval says nothing, since it is as wide as the range of an index."""
    reason = "not known: rare samples carry so much of the variance that the interval spans the whole range"
    return [
        absent(reason, e.method, e.evaluations, Why.NOT_KNOWN)
        if e.value is not None and e.half_width > WORTHLESS
        else e
        for e in row
    ]


@dataclass(frozen=True, kw_only=True)
class Surrogate:
    """A cheap model: its outputs (R, N, blocks.count) on the model's own blocks, and its `indices`, as those of
    `expansion_indices` by "first", "total", "second", "group_first" and "group_total", or its outputs (R, M,
    blocks.count) on `many` points of the same replicates, which tell them.
    """

    outputs: Array
    indices: Mapping[str, Array] = field(default_factory=dict)
    many: Array | None = None


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


def sampled_indices(outputs: Array, blocks: Blocks, surrogate: Surrogate | None = None) -> SampledIndices:
    """Every index that the blocks allow, each by the estimator that suits its size.

    With the blocks of second order all first and total indices are those of Azzini and Rosati.  Without, an input
    whose total index (Jansen's) is above `LARGE` has both of its indices from the correlation of pairs, every other
    its first index from Saltelli 2010 and its total index from Jansen.  The size of an index decides and never the
    width of an interval: to take the narrower of two intervals would choose those that are narrow by chance.

    With a `surrogate` every index is corrected by what the same points make of the surrogate's, whose truth is known
    (`uqsphere.uq.estimate.corrected`): the answer stays that of the model, whatever the surrogate leaves out, as long
    as it was fitted to other points.  It needs four replicates.

    Parameters
    ----------
    outputs : (R, N, blocks.count) array
        The model on the blocks of R independent replicates; a constant is answered by absent estimates.

    Nothing is clipped.  Raises ValueError for outputs that are not finite or of another shape.
    """
    y = blocks.split(outputs)
    d, groups = blocks.inputs_count, len(blocks.groups)
    pairs = list(combinations(range(d), 2)) if blocks.second else []
    if not y.varies:
        none = absent(_NO_SCATTER, METHOD, y.evaluations)
        return SampledIndices(first=[none] * d, total=[none] * d, second=dict.fromkeys(pairs, none),
                              group_first=[none] * groups, group_total=[none] * groups,
                              text=f"No index is given: {_NO_SCATTER}.")  # fmt: skip
    large = _large(y, y.ab) if y.ba is None else ()
    chosen = large, _large(y, y.groups)
    found = _helped(y, blocks, surrogate, chosen)
    helped = "" if surrogate is None else _CONTROLLED if surrogate.many is None else _TABULATED
    return SampledIndices(
        first=found["first"], total=found["total"], second=dict(zip(pairs, found["second"], strict=True)),
        group_first=found["group_first"], group_total=found["group_total"], large=large,
        text=choice_text(blocks, len(large)) + helped,
    )  # fmt: skip


def _helped(y: Outputs, blocks: Blocks, surrogate: Surrogate | None, chosen: _Chosen) -> dict[str, list[Estimate]]:
    """The indices by order, corrected by a surrogate where there is one that varies."""
    answers, alone = _answers(y, *chosen), _carriers(y, None, chosen)
    plain = {
        order: [_estimate(*one, y.evaluations) for one in zip(rows.T, methods, alone[order], strict=True)]
        for order, (rows, methods) in answers.items()
    }
    known = None if surrogate is None else blocks.split(surrogate.outputs)
    if surrogate is None or known is None or not known.varies:
        return plain
    # the surrogate's indices by order: (m,), or (R, m) as many points of the replicates tell them
    truths, loads = surrogate.indices, {}
    if surrogate.many is not None:
        many = blocks.split(surrogate.many)
        truths = {order: rows for order, (rows, _) in _answers(many, *chosen).items()}
        loads = _carriers(many, None, chosen)
    others, carriers = _answers(known, *chosen), _carriers(y, known, chosen)
    found: dict[str, list[Estimate]] = {}
    for order, (rows, _) in answers.items():
        truth_of = truths.get(order, np.empty(0)).T
        load = np.stack([carriers[order], loads.get(order, np.full(len(truth_of), math.inf))], axis=1)
        columns = zip(rows.T, others[order][0].T, truth_of, load, plain[order], strict=True)
        found[order] = [_corrected(*one) for one in columns]
    return found


def _corrected(rows: Array, others: Array, truth: Array, carriers: Array, plain: Estimate) -> Estimate:
    """A corrected answer, from those of the model and of the surrogate (R,), and the truth of the latter: a number, or
    (R,) from many points.

    `carriers` (2,) are the points that carry what the correction may be off by, and the many.  Where the rows alone,
    `plain`, know it better they answer; not beside many points, which are there since the rows alone may have met none
    of what matters.
    """
    if plain.value is None:
        return plain
    method, replicates = f"{plain.method}, controlled by a surrogate", len(rows)
    value, error = corrected(rows, others - np.mean(truth))
    known = spread(truth) if np.ndim(truth) else 0.0
    if not (math.isfinite(error) and math.isfinite(known)):
        return plain
    # a surrogate that is the model itself leaves rounding, of its coefficients as of the sums
    own, of_many = freedom(replicates, carriers).tolist()
    error, free = added([(max(error, 1e-13), own), (known, of_many)])
    half = student(1.0 + free) * error
    if half > plain.half_width and not np.ndim(truth):
        return plain
    return around(value, half, error, method, plain.evaluations)


def _carriers(y: Outputs, known: Outputs | None, chosen: _Chosen) -> dict[str, Array]:
    """How many points of the design carry what each answer, corrected by what is known, may be off by: Kish's count
    (m,) by order."""
    sums: dict[str, Array] = {}
    for r in range(len(y.a)):
        own = _answers(y.points(r), *chosen)
        other = {} if known is None else _answers(known.points(r), *chosen)
        for order, (rows, _) in own.items():
            off = rows - other[order][0] if other else rows
            squares = (off - off.mean(axis=0)) ** 2
            sums[order] = sums.get(order, 0.0) + np.array([squares.sum(axis=0), (squares**2).sum(axis=0)])
    return {
        order: np.where(fourth > 0.0, second**2 / np.where(fourth > 0.0, fourth, 1.0), math.inf)
        for order, (second, fourth) in sums.items()
    }


def ordered(first: Sequence[Estimate], total: Sequence[Estimate]) -> tuple[list[Estimate], list[Estimate]]:
    """First and total indices (d,) with room for what is known of them, that no first one is larger than the total one.

    Each has its own estimator: where the intervals contradict it, the wider reaches to the far end of the other.
    """
    alone, whole = list(first), list(total)
    for j, (one, other) in enumerate(zip(first, total, strict=True)):
        if one.low is None or one.high is None or other.low is None or other.high is None or one.low <= other.high:
            continue
        if one.half_width < other.half_width:
            whole[j] = other.spanning(other.low, one.high)
        else:
            alone[j] = one.spanning(other.low, one.high)
    return alone, whole


def _large(outputs: Outputs, mixed: Array) -> tuple[int, ...]:
    """Numbers of the inputs or groups whose total index, by Jansen's estimator, is above `LARGE`."""
    if not mixed.shape[2]:
        return ()
    numerator, denominator = jansen_total(outputs.a, outputs.b, mixed)
    return tuple(np.flatnonzero(numerator.mean(axis=0) > LARGE * denominator.mean(axis=0)).tolist())


def _answers(outputs: Outputs, large: tuple[int, ...], large_groups: tuple[int, ...]) -> dict[str, _Answer]:
    """Answers (R, m) of the replicates and their methods, by order."""
    found = {}
    if outputs.ba is not None:
        arguments = outputs.a, outputs.b, outputs.ab, outputs.ba
        for order, ratio in ESTIMATORS["azzini_rosati"].items():
            rows = _rows(ratio(*arguments))
            found[order] = rows, [_method("azzini_rosati", order)] * rows.shape[1]
        rows = _rows(_second_order(outputs))
        found["second"] = rows, [f"{METHOD}, second order"] * rows.shape[1]
    else:
        found |= _by_size(outputs, outputs.ab, large)
        found["second"] = np.empty((len(outputs.a), 0)), []
    groups = _by_size(outputs, outputs.groups, large_groups)
    return found | {f"group_{order}": answer for order, answer in groups.items()}


def _by_size(outputs: Outputs, mixed: Array, large: tuple[int, ...]) -> dict[str, _Answer]:
    """First and total answers from the blocks AB of inputs or groups; those that are `large` off pairs."""
    found = {}
    for order in ("first", "total"):
        rows = _rows(ESTIMATORS["saltelli"][order](outputs.a, outputs.b, mixed))
        methods = [_method("saltelli", order)] * mixed.shape[2]
        if large:
            rows[:, list(large)] = _rows(
                ESTIMATORS["janon_monod"][order](outputs.a, outputs.b, mixed[:, :, list(large)])
            )
        for j in large:
            methods[j] = _method("janon_monod", order)
        found[order] = rows, methods
    return found


def _second_order(outputs: Outputs) -> Ratio:
    """Interaction indices S_ij of all pairs, <(ba_i - b)(ab_j - a)> / V and the same with i and j exchanged.

    BA_i and AB_j share the columns i and j, so that <ba_i ab_j> is the closed index of the pair (Saltelli, Comput.
    Phys. Commun. 145, 2002, 280, theorem 2); <ba_i a> and <b ab_j> are the first indices, which the product takes off
    with the noise that they share.
    """
    if outputs.ba is None:
        raise ValueError("second order needs the blocks BA: Blocks(second=True)")
    ba, ab = outputs.ba - outputs.b, outputs.ab - outputs.a
    _, n, d = ba.shape
    products = np.matmul(ba.transpose(0, 2, 1), ab) / n
    rows, columns = np.triu_indices(d, 1)
    numerator = 0.5 * (products[:, rows, columns] + products[:, columns, rows])
    v = 0.5 * block_mean(outputs.a**2 + outputs.b**2)
    return numerator, np.repeat(v, rows.size, axis=1)


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


# --- two ways beside each other ---------------------------------------------------------------------------


def agree(first: Estimate, second: Estimate, floor: float = 1e-4) -> bool:
    """Whether two estimates of one number are compatible: their difference within both half-widths together.

    `floor` is a difference too small to matter.  An absent estimate contradicts nothing.
    """
    if first.value is None or second.value is None:
        return True
    allowed = first.half_width + second.half_width + floor
    return abs(first.value - second.value) <= allowed


def cross_check(
    names: Sequence[str], sampled: Mapping[str, Sequence[Estimate]], surrogate: Mapping[str, Sequence[Estimate]]
) -> tuple[bool, str]:
    """Indices from sampling and from the surrogate, input by input: (all agree, text for the report).

    >>> from uqsphere.uq.estimate import from_replicates
    >>> one = from_replicates(np.array([0.5, 0.52, 0.51]), "a", 3)
    >>> other = from_replicates(np.array([0.7, 0.72, 0.71]), "b", 3)
    >>> cross_check(["x"], {"first": [one]}, {"first": [other]})
    (False, 'Sampling and surrogate disagree on 1 of 1 index: first of x (0.5100 against 0.7100).')
    """
    apart, compared, largest = [], 0, 0.0
    for order in ("first", "total"):
        for name, one, other in zip(names, sampled.get(order, ()), surrogate.get(order, ()), strict=False):
            if one.value is None or other.value is None:
                continue
            compared += 1
            largest = max(largest, abs(one.value - other.value))
            if not agree(one, other):
                apart.append(f"{order} of {name} ({one.value:.4f} against {other.value:.4f})")
    if not compared:
        return True, "No index was answered by both sampling and surrogate."
    noun = "index" if compared == 1 else "indices"
    if apart:
        return False, (f"Sampling and surrogate disagree on {len(apart)} of {compared} {noun}: {'; '.join(apart)}.")
    return True, (
        f"Sampling and surrogate agree on {compared} {noun} within their intervals (largest difference {largest:.2g})."
    )


# --- an expansion as the cheap model, whose indices are known exactly ------------------------------


def expansion_indices(coefficients: Array, multi_indices: npt.NDArray[np.int64], blocks: Blocks) -> dict[str, Array]:
    """Indices of an expansion in products of orthonormal polynomials, exactly: what a `Surrogate` is known by.

    Parameters
    ----------
    coefficients : (P,) array
    multi_indices : (P, d) array
        Degrees of each product; the constant has none.
    blocks : Blocks

    >>> degrees = np.array([[0, 0], [1, 0], [1, 1]])
    >>> found = expansion_indices(np.array([5.0, 3.0, 1.0]), degrees, Blocks(inputs_count=2, second=True))
    >>> found["first"].tolist(), found["total"].tolist(), found["second"].tolist()
    ([0.9, 0.0], [1.0, 0.1], [0.1])
    """
    active = multi_indices > 0
    count = active.sum(axis=1)
    varying = np.where(count > 0, coefficients, 0.0)
    # by a power of two, which rounds nothing: the squares of 1e300 are beyond floating point
    shares = np.ldexp(varying, -np.frexp(np.abs(varying).max())[1]) ** 2
    shares = shares / shares.sum()
    rows, columns = np.triu_indices(blocks.inputs_count, 1) if blocks.second else (np.array([], int),) * 2
    inside = [active[:, list(group)].sum(axis=1) for group in blocks.groups]
    return {
        "first": np.asarray(shares @ (active & (count == 1)[:, None])),
        "total": np.asarray(shares @ active),
        "second": np.asarray(shares @ (active[:, rows] & active[:, columns] & (count == 2)[:, None])),
        "group_first": np.array([shares[k == count].sum() for k in inside]),
        "group_total": np.array([shares[k > 0].sum() for k in inside]),
    }


def mean_expansion(fits: Sequence[Chaos]) -> Chaos:
    """The mean of plain expansions in the same germs: their terms together, each with its mean coefficient.

    Raises ValueError for an expansion of a transformed output or in two pieces: its indices are not known exactly.
    """
    if not all(fit.plain for fit in fits):
        raise ValueError("a control variate takes expansions of the output itself, in one piece: fit them with plain")
    degrees = np.concatenate([fit.multi_indices for fit in fits])
    values = np.concatenate([fit.coefficients for fit in fits]) / len(fits)
    terms, place = np.unique(degrees, axis=0, return_inverse=True)
    coefficients = np.zeros(len(terms))
    np.add.at(coefficients, place.reshape(-1), values)
    # the constant first, as in every expansion: np.unique sorts it there
    piece = replace(fits[0].pieces[0], coefficients=coefficients, multi_indices=terms)
    return replace(fits[0], pieces=(piece,), samples=sum(f.samples for f in fits))


def chaos_outputs(chaos: Chaos, blocks: Blocks, halves: Sequence[Array]) -> Array:
    """Values (N, blocks.count) of an expansion on the blocks of halves of independent standard normals, (N, d) each."""
    points = blocks.mix(*(germ_points(half, chaos.germs) for half in halves))
    return predict(chaos, points.reshape(-1, blocks.inputs_count)).reshape(-1, blocks.count)


def chaos_surrogate(chaos: Chaos, blocks: Blocks, outputs: Array) -> Surrogate | None:
    """An expansion with its `chaos_outputs` (R, N, blocks.count) as a surrogate; None where it is a constant."""
    if not chaos.coefficients[chaos.multi_indices.any(axis=1)].any():
        return None
    return Surrogate(outputs=outputs, indices=expansion_indices(chaos.coefficients, chaos.multi_indices, blocks))
