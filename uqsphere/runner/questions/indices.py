"""Which input drives what: Sobol' indices by pick and freeze and by polynomial chaos, checked against each other."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.results import Fields, SpeedRow, SurrogateEntry
from uqsphere.runner.beside import elsewhere
from uqsphere.runner.campaign import INDEX_KIND, Accuracy, Cost, Course, Missed, campaign, indices_missed, speed_rows_of
from uqsphere.runner.evaluate import MOST_DROPPED, Work, evaluate_points
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.schedule import INDICES, REPLICATES, TABLE
from uqsphere.runner.similarity import Tabled, begin_table
from uqsphere.units import told_apart
from uqsphere.uq import Estimate, Sample, Why, absent, widest, without
from uqsphere.uq.heavy_tails import (
    FEW_CARRIERS,
    HeavyTail,
    carriers,
    no_narrower,
    tail_of,
    why_no_shares,
    widened_share,
)
from uqsphere.uq.indices import (
    METHOD,
    Blocks,
    SampledIndices,
    Surrogate,
    believable,
    cross_check,
    ordered,
    sampled_indices,
    uniform_halves,
)

# --- variances that are not there, or rest on a handful of samples -------------------------------------------


def share_heavy(
    work: Work, sampled: Sampled, found: dict[str, Sensitivity], carried: Mapping[str, float]
) -> dict[str, Sensitivity]:
    """Indices without those of a variance that does not exist, does not converge, or rests on a handful of samples.

    Where the variance exists and fourth moments do not, the intervals hold what the variance may be.  Where few points
    carry it (`carried`, as `Shared` has them) and no expansion helps, they hold what so few may have missed.
    """
    laws = {name: work.study.random[name] for name in work.scene_names}
    tails = {q: tail_of(laws, sampled.sample, q) for q in work.quantities}
    return shares_with_tails(work, sampled, found, tails, carried)


def shares_with_tails(
    work: Work,
    sampled: Sampled,
    found: dict[str, Sensitivity],
    tails: Mapping[str, HeavyTail | None],
    carried: Mapping[str, float],
) -> dict[str, Sensitivity]:
    """The same with the tail that each quantity inherits."""
    answers, asked = {}, work.study.analysis.accuracy.sobol
    for quantity in work.quantities:
        indices, sd, tail = found[quantity], sampled.descriptions[quantity].sd, tails[quantity]
        # where no input is random nothing is missed either
        reason = why_no_shares(sampled.sample.outputs(quantity), sd) if work.scene_names else None
        if reason is not None:
            # that the variance is not there weighs more than why an index was absent before
            every = reason.why is Why.NO_VARIANCE
            indices = _each(indices, lambda e, why=reason: absent(why, e.method, e.evaluations), every)  # type: ignore[misc]
            # no number of evaluations gives what is not there, so that none is missed
            missed = [] if sd.why is Why.NO_MOMENT else [indices_missed(quantity, None, asked, f": {reason.text}")]
            indices = replace(indices, text=reason.text, missed=missed, sampled={}, expanded={}, agree=None)
        elif tail is not None and tail.order <= 4.0:
            indices = _each(indices, lambda e, sd=sd: widened_share(e, sd))  # type: ignore[misc]
        elif (count := carried.get(quantity, FEW_CARRIERS)) < FEW_CARRIERS and not indices.expanded:
            indices = _each(indices, lambda e, count=count: no_narrower(e, count))  # type: ignore[misc]
        answers[quantity] = _admitted(quantity, indices, found[quantity], asked)
    return answers


def _admitted(quantity: str, indices: Sensitivity, before: Sensitivity, asked: float) -> Sensitivity:
    """Indices whose intervals were widened beyond what was asked, with that said, of the width that they have now."""
    width = indices.width
    if width <= asked or (indices.missed and width <= before.width):
        return indices
    why = " (so few samples carry the variance: how many evaluations would reach it is not known)"
    return replace(indices, missed=[indices_missed(quantity, width, asked, why)])


def _each(indices: Sensitivity, change: Callable[[Estimate], Estimate], every: bool = False) -> Sensitivity:
    """Every index that is given changed, and with `every` those that are absent too."""

    def row(estimates: dict[str, Estimate]) -> dict[str, Estimate]:
        return {name: change(e) if every or e.value is not None else e for name, e in estimates.items()}

    return replace(
        indices,
        first=row(indices.first),
        total=row(indices.total),
        second=row(indices.second),
        group_first=row(indices.group_first),
        group_total=row(indices.group_total),
        shapley=row(indices.shapley),
        kucherenko={order: row(estimates) for order, estimates in indices.kucherenko.items()},
    )


if TYPE_CHECKING:
    from uqsphere.uq.expansion import Chaos
    from uqsphere.uq.shapley import SubsetDesign

# --- The design of pick and freeze for a study: which blocks, their outputs, and what failures leave of them.

Flags = npt.NDArray[np.bool_]


def blocks_of(work: Work) -> Blocks:
    """The blocks that the study's indices take: those of first and total indices come first."""
    names = work.scene_names
    analysis = work.study.analysis
    return Blocks(
        inputs_count=len(names),
        second=analysis.second_order and len(names) > 1,
        groups=tuple(tuple(names.index(name) for name in group) for group in analysis.groups.values()),
    )


def design_rows(work: Work, start: int, count: int, blocks: Blocks) -> Array:
    """The rows (R count blocks, d) of base points of the design."""
    inputs = work.all_inputs.only(work.scene_names)
    # the inputs are independent here, so the halves are mapped once and mixed afterwards
    rows = [
        blocks.mix(*(inputs.physical(half) for half in halves)) for halves in normal_halves(work, start, count, blocks)
    ]
    return np.stack(rows).reshape(-1, blocks.inputs_count)


def normal_halves(work: Work, start: int, count: int, blocks: Blocks) -> Iterator[list[Array]]:
    """The halves of every replicate as independent standard normals."""
    from scipy.special import ndtri

    for replicate in range(REPLICATES):
        halves = uniform_halves(
            blocks, count=count, seed=work.study.seed, task="sensitivity", replicate=replicate, start=start
        )
        yield [np.asarray(ndtri(half)) for half in halves]


def surrogate_outputs(work: Work, start: int, count: int, blocks: Blocks, chaoses: Sequence[Chaos]) -> Array:
    """What expansions say at the points of `pick_and_freeze`, (R, count, blocks, len(chaoses))."""
    from uqsphere.uq.indices import chaos_outputs

    rows = [
        np.stack([chaos_outputs(chaos, blocks, halves) for chaos in chaoses], axis=-1)
        for halves in normal_halves(work, start, count, blocks)
    ]
    return np.stack(rows)


def helpers_of(chaoses: Mapping[str, Chaos], blocks: Blocks, outputs: Array | None) -> dict[str, Surrogate]:
    """The expansions as control variates, by quantity, from their outputs (R, N, blocks, len(chaoses))."""
    if outputs is None:
        return {}
    from uqsphere.uq.indices import chaos_surrogate

    made = {q: chaos_surrogate(chaos, blocks, outputs[..., k]) for k, (q, chaos) in enumerate(chaoses.items())}
    return {q: surrogate for q, surrogate in made.items() if surrogate is not None}


def lost_designs(failed: Flags) -> str:
    """Why no design of indices is made: too many of its runs would fail; or an empty text.

    A design of pairs loses a base point with any of its runs, and an expansion sees nothing where the model has no
    answer, so that both would answer for laws that nobody gave.
    """
    if failed.mean() <= MOST_DROPPED:
        return ""
    return (
        f"{100.0 * failed.mean():.2g} % of the evaluations failed, and indices of the others would be those of other "
        f"laws; they are given up to {100.0 * MOST_DROPPED:g} %: narrow the inputs to where the model answers"
    )


#: evaluations that sampling takes go with this power of the half-widths, where outputs jump
FALL = 1.8
#: points of each replicate that the expansion is fitted to, and replicates that are fitted
FIT_POINTS = 256
FITS = 8
#: fits that are kept where many inputs need several randomisations for each: what fewer agree on tells no interval
_LEAST_FITS: Final = 4
CHAOS = "polynomial chaos"
OTHERS_LOST = "its runs and those of another output lack too many answers together"
HELD_OUT = "share of the variance left unexplained (held out)"


def no_surrogate() -> SurrogateEntry:
    """What is said of a surrogate where none was fitted."""
    return SurrogateEntry(kind=None, error=None, evaluations=0)


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """Indices of one quantity: which are given, both ways that found them, and how they agree.

    `second` goes by "a|b" of two inputs, `group_first` and `group_total` by the names of the groups; `estimators`
    says what sampling read the indices off, and why.  Where inputs depend on each other `first` and `total` are
    absent, and `shapley` and `kucherenko` ("first" and "total" of each input) take their place.
    """

    first: dict[str, Estimate]
    total: dict[str, Estimate]
    surrogate: SurrogateEntry
    sampled: dict[str, list[Estimate]]
    expanded: dict[str, list[Estimate]]
    agree: bool | None
    text: str
    missed: list[Missed] = field(default_factory=list)
    shapley: dict[str, Estimate] = field(default_factory=dict)
    kucherenko: dict[str, dict[str, Estimate]] = field(default_factory=dict)
    second: dict[str, Estimate] = field(default_factory=dict)
    group_first: dict[str, Estimate] = field(default_factory=dict)
    group_total: dict[str, Estimate] = field(default_factory=dict)
    estimators: str = ""

    @classmethod
    def none(
        cls,
        names: Sequence[str],
        nothing: Estimate,
        *,
        surrogate: SurrogateEntry | None = None,
        text: str = "",
        missed: Sequence[Missed] = (),
    ) -> Sensitivity:
        """No index of the inputs, and why."""
        return cls(first=dict.fromkeys(names, nothing), total=dict.fromkeys(names, nothing),
                   surrogate=surrogate or no_surrogate(), sampled={}, expanded={}, agree=None,
                   text=text or str(nothing.reason), missed=[*missed])  # fmt: skip

    @property
    def width(self) -> float:
        """The largest half-width of the first and total indices and Shapley effects that there are."""
        return widest(self.first.values(), self.total.values(), self.shapley.values())

    def estimates(self) -> list[Estimate]:
        """Every index that is given."""
        rows = (self.first, self.total, self.second, self.group_first, self.group_total, self.shapley)
        return [e for row in (*rows, *self.kucherenko.values()) for e in row.values()]

    def entry(self, names: Sequence[str]) -> Fields:
        """The same as results.json has it, without what drives the quantity beside it; of the inputs by these names."""

        def named(rows: Mapping[str, Sequence[Estimate]]) -> dict[str, dict[str, Estimate]]:
            return {order: dict(zip(names, row, strict=True)) for order, row in rows.items()}

        check = {"agree": self.agree, "text": self.text, "sampled": named(self.sampled), "chaos": named(self.expanded)}
        return {
            "first": self.first,
            "total": self.total,
            **({"second": self.second} if self.second else {}),
            **({"groups": {"first": self.group_first, "total": self.group_total}} if self.group_first else {}),
            **({"shapley": self.shapley, "kucherenko": self.kucherenko} if self.shapley else {}),
            "estimators": self.estimators,
            "surrogate": self.surrogate,
            "check": check,
        }


@dataclass(frozen=True, kw_only=True)
class Pairs:
    """Runs of a design that share inputs: values (R, N, rows, q), base points with a failure (R, N)."""

    values: Array
    failed: Flags

    @classmethod
    def evaluated(cls, work: Work, key: str, rows: Array, shape: tuple[int, int, int]) -> Pairs:
        """The outputs of such rows (n, d)."""
        answered = evaluate_points(work, key, work.scene_names, rows)
        failed = ~(answered.good | np.isfinite(answered.values).all(axis=1)).reshape(shape)
        return cls(values=answered.values.reshape(*shape, -1), failed=np.asarray(failed.any(axis=2)))

    def join(self, other: Pairs) -> Pairs:
        """These runs and those that continue them."""
        return Pairs(
            values=np.concatenate([self.values, other.values], axis=1),
            failed=np.concatenate([self.failed, other.failed], axis=1),
        )

    def whole(self) -> Array:
        """The same number of base points without a failure from every replicate, (R, N', rows, q)."""
        return without(self.values, self.failed)


@dataclass(frozen=True, kw_only=True)
class Shared:
    """How the variance of every quantity is shared out, why its stages ended, and the runs that it rests on.

    `subsets` is the design of these runs where inputs depend on each other, `tabled` the table beside them.  `carried`:
    how many base points carry the variance of a quantity, of the table where it was asked, else of the runs.
    """

    sensitivity: dict[str, Sensitivity]
    stopped: str
    pairs: Pairs | None = None
    subsets: SubsetDesign | None = None
    tabled: Tabled = field(default_factory=lambda: Tabled())
    carried: dict[str, float] = field(default_factory=dict)


def dependent_names(work: Work) -> list[str]:
    """Model inputs that depend on another model input."""
    return work.all_inputs.only(work.scene_names).tied()


@dataclass(frozen=True, kw_only=True)
class Expansion:
    """Indices off polynomial chaos, what its validation says, and the mean of the expansions.

    Empty and None where they are refused.
    """

    indices: dict[str, list[Estimate]] = field(default_factory=dict)
    about: SurrogateEntry = field(default_factory=no_surrogate)
    chaos: Chaos | None = None


def _expand(work: Work, sampled: Sampled, quantity: str) -> Expansion:
    """Polynomial chaos of a quantity on the sampled points, validated on others."""
    from uqsphere.uq.expansion import chaos_indices, error_with_tails, fit_again, judge, validation_error
    from uqsphere.uq.indices import mean_expansion

    d, alone = len(work.scene_names), not work.study.analysis.samples_indices
    # where pairs of runs correct what a table is off by, it has more points to fit to
    sample, fitted = sampled.sample, sampled.sample if alone else sampled.rows
    least = 4 * (int(work.active.sum()) + 1)
    # many inputs take the rows of several randomisations for one fit
    joined = min(-(-least // sample.count), max(1, sample.replicates // (2 * _LEAST_FITS)))
    count = min(FITS, sample.replicates // (2 * joined))
    used = min(max(joined * FIT_POINTS, least), joined * fitted.count)

    def rows_of(sample: Sample, block: int, most: int | None = None) -> tuple[Array, Array]:
        return _answered_rows(work, sample, quantity, slice(joined * block, joined * (block + 1)), most)

    fits: list[Chaos] = []
    errors = []
    for replicate in range(count):
        points, column = rows_of(fitted, replicate, used)
        if len(points) < least:
            reason = f"{len(points)} samples with an answer are too few for an expansion in {d} inputs: {least} are due"
            return Expansion(about=no_surrogate().model_copy(update={"reason": reason}))
        # as an answer of its own, the interval has to hold the choice of terms too
        fits.append(fit_again(fits[0], points, column) if fits and not alone else _fit(work, points, column, fits))
        # held out: other randomisations altogether
        errors.append(validation_error(fits[-1], *rows_of(sample, count + replicate)))
    error = float(np.mean(errors))
    own = error_with_tails(fits, error)
    # sampling corrects a control variate whatever it leaves out; nothing corrects an answer of its own
    verdict = judge(fits[0], own if alone else error)
    evaluations = count * min(used, joined * sample.count)
    about = SurrogateEntry(
        kind=CHAOS, error=verdict.error, evaluations=evaluations, usable=verdict.usable, reason=verdict.reason,
        degree=fits[0].degree, terms=int(fits[0].coefficients.size),
    )  # fmt: skip
    if not verdict.usable:
        return Expansion(about=about)
    found = chaos_indices(fits, error=own, evaluations=evaluations)
    return Expansion(indices=found, about=about, chaos=mean_expansion(fits))


def _answered_rows(work: Work, sample: Sample, quantity: str, own: slice, most: int | None) -> tuple[Array, Array]:
    """Points and outputs of the rows with an answer among the first ones of some randomisations."""
    from uqsphere.uq.expansion import germ_points

    d, keep = len(work.scene_names), ~sample.lost(quantity)[own].ravel()[:most]
    scores = sample.scores[own, :, :d].reshape(-1, d)[:most]
    return germ_points(scores[keep], work.germs), sample.answer(quantity)[own].ravel()[:most][keep]


def _fit(work: Work, points: Array, column: Array, before: Sequence[Chaos]) -> Chaos:
    """Chaos in the inputs that matter; the mean of several fits takes one set of germs, that of the first."""
    from uqsphere.uq.expansion import fit_chaos, padded

    germs = before[0].germs if before else work.germs
    own = [germ for germ, matters in zip(germs, work.active, strict=True) if matters]
    one = fit_chaos(points[:, work.active], column, own, plain=True, settled=bool(before))
    return padded(one, work.active, work.germs)


def _more(start: int, widths: list[float], asked: float) -> int:
    """Base points to add to every replicate: what the widest interval calls for, at most three times what is there."""
    if start == 0:
        return INDICES.first
    wanted: float = start * ((max(widths, default=asked) / asked) ** FALL - 1.0)
    return 64 * max(1, math.ceil(min(max(wanted, 0.25 * start), 3.0 * start) / 64.0 - 0.5))


def _no_finer(work: Work, estimates: Sequence[Estimate]) -> list[Estimate]:
    """Intervals no narrower than the tolerance of the model itself, which a surrogate that fits it can be."""
    if work.study.black_box:
        return list(estimates)
    least = work.study.model.tolerance
    return [
        e
        if e.value is None or e.half_width >= least
        else replace(e, low=e.value - least, high=e.value + least, std_error=max(e.std_error or 0.0, 0.5 * least))
        for e in estimates
    ]


@dataclass(kw_only=True)
class PairedRuns:
    """What all indices off pairs of runs have in common as questions."""

    work: Work
    pairs: Pairs | None = None
    method: str = METHOD

    @property
    def spent(self) -> int:
        """Evaluations of pairs so far."""
        return 0 if self.pairs is None else int(self.pairs.values[..., 0].size)

    @property
    def asked(self) -> float:
        """Half-width that the study asks for."""
        return self.work.study.analysis.accuracy.sobol

    def add(self, more: Pairs) -> None:
        """Go on with more of them."""
        self.pairs = more if self.pairs is None else self.pairs.join(more)

    def widths(self) -> dict[str, float]:
        """The largest half-width of every quantity that has an index."""
        raise NotImplementedError

    def lacking(self) -> dict[Accuracy, float]:
        """Half-width over what is asked of the quantities whose indices are wider."""
        return {Accuracy(q, "indices"): w / self.asked for q, w in self.widths().items() if w > self.asked}

    def errors(self) -> list[SpeedRow]:
        """The widest index of every quantity."""
        rows = [speed_rows_of(self.method, q, self.spent, w, INDEX_KIND) for q, w in self.widths().items()]
        return [one for row in rows for one in row]


@dataclass(kw_only=True)
class Indices(PairedRuns):
    """Sobol' indices of every quantity, from the base points that were drawn so far (a `Question`).

    Where more of them would take more evaluations than a table of the scaled answers, that is made, and asked at many
    more points; the model's own then tell by how much it is off.
    """

    expansions: dict[str, Expansion]
    blocks: Blocks
    judged: int = 0
    tabled: Tabled = field(default_factory=Tabled)
    answers_of_table: Array | None = None
    others: Array | None = None
    drawn: dict[str, SampledIndices] = field(default_factory=dict)
    found: dict[str, dict[str, list[Estimate]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.judged = INDICES.judged * REPLICATES * self.blocks.count
        self.found = {q: {} for q in self.work.quantities}

    @property
    def size(self) -> int:
        """Evaluations that the indices rest on."""
        return 0 if self.pairs is None else int(self.pairs.whole()[..., 0].size) + self.tabled.taken

    def advance(self, room: float) -> bool:
        """More base points, as many as the widest interval calls for; False where they have no room."""
        self.tabled = self.tabled.turned(max(self.lacking().values(), default=0.0))
        if self.pairs is not None and (count := self.tabled.grown(self.pairs.failed.shape[1], room)):
            self._ask_table(count)
            return True
        start = 0 if self.pairs is None else self.pairs.failed.shape[1]
        count = _more(start, [ratio * self.asked for ratio in self.lacking().values()], self.asked)
        if self.tabled.count:  # of what a table leaves, twice the pairs know all that they can in one step
            count = start
        if not start and self._cost(count) > room:
            count = INDICES.least
        if self._cost(count) > room:
            return False
        rows, shape = design_rows(self.work, start, count, self.blocks), (REPLICATES, count, self.blocks.count)
        more = Pairs.evaluated(self.work, f"sensitivity.{start}", rows, shape)
        self.add(more)
        self._expand(start, count)
        self._estimate()
        if not start and not more.failed.any():
            self._begin_table(room - self._cost(count))
        return True

    def _cost(self, count: int) -> int:
        return REPLICATES * count * self.blocks.count

    def _estimate(self) -> None:
        """The indices off all pairs, with what helps each quantity."""
        assert self.pairs is not None
        whole, helpers = self.pairs.whole(), self._helpers(self.pairs)
        for k, quantity in enumerate(self.work.quantities):
            drawn = sampled_indices(whole[..., k], self.blocks, helpers.get(quantity))
            self.drawn[quantity] = drawn
            self.found[quantity] = {
                "first": _no_finer(self.work, drawn.first), "total": _no_finer(self.work, drawn.total)
            }  # fmt: skip

    # --- a table beside the pairs

    def _begin_table(self, room: float) -> None:
        """A table, where sampling alone would take more; for what is not accurate enough, or has no expansion."""
        late = self.lacking()
        forecast = self.size * min(max(late.values(), default=0.0), 1e3) ** FALL
        self.tabled = begin_table(self.work, self.tabled, self.size, forecast, room)
        if self.tabled.begun:
            helped = {accuracy.subject for accuracy in late} | (set(self.work.quantities) - set(self._chaoses()))
            self.tabled = replace(self.tabled, quantities=tuple(q for q in self.work.quantities if q in helped))
            self._ask_table(TABLE.first * INDICES.first)

    def _ask_table(self, count: int) -> None:
        """The table at so many base points, and the indices of what is not accurate enough with its help."""
        have, before = self.tabled.count, self.answers_of_table
        rows = design_rows(self.work, have, count - have, self.blocks)
        self.tabled, values, _ = self.tabled.asked(self.work, "indices", rows, count)
        if not self.tabled.begun:
            self.answers_of_table = None
            return
        values = values.reshape(REPLICATES, count - have, self.blocks.count, -1)
        self.answers_of_table = values if before is None else np.concatenate([before, values], axis=1)
        self._estimate()

    def _expand(self, start: int, count: int) -> None:
        """What the expansions say at further points."""
        if chaoses := self._chaoses():
            more = surrogate_outputs(self.work, start, count, self.blocks, list(chaoses.values()))
            self.others = more if self.others is None else np.concatenate([self.others, more], axis=1)

    def _chaoses(self) -> dict[str, Chaos]:
        return {q: one.chaos for q, one in self.expansions.items() if one.chaos is not None}

    def _helpers(self, pairs: Pairs) -> dict[str, Surrogate]:
        """What stands beside the pairs: the expansions, or the table."""
        others = None if self.others is None else without(self.others, pairs.failed)
        found = helpers_of(self._chaoses(), self.blocks, others)
        if (values := self.answers_of_table) is not None:
            n = pairs.failed.shape[1]
            for quantity in self.tabled.quantities:
                outputs = values[..., self.work.quantities.index(quantity)]
                found[quantity] = Surrogate(outputs=outputs[:, :n], many=outputs)
        return found

    def widths(self) -> dict[str, float]:
        found = self.found
        return {
            q: widest(found[q]["first"], found[q]["total"], _sets(drawn))
            for q, drawn in self.drawn.items()
            if any(e.value is not None for e in (*found[q]["first"], *found[q]["total"], *_sets(drawn)))
        }

    def answer(self, course: Course) -> Shared:
        """The indices of every quantity, of the model itself where it was sampled, else of its expansion."""
        answers, whole, carried = {}, None if self.pairs is None else self.pairs.whole(), {}
        for k, quantity in enumerate(self.work.quantities):
            one, cost = self.expansions[quantity], course.cost(Accuracy(quantity, "indices"))
            concluded = _conclude(quantity, self.work.scene_names, self.found[quantity], one, self.asked, cost)
            if whole is not None and concluded.sampled:
                concluded = _beside_salib(concluded, whole[:, :, : self.blocks.inputs_count + 2, k])
                many = self.answers_of_table if quantity in self.tabled.quantities else None
                carried[quantity] = carriers((whole if many is None else many)[:, :, 0, k].ravel())
            answers[quantity] = _with_sets(self.work, quantity, concluded, self.drawn.get(quantity), self.asked, cost)
        plain = None
        if self.pairs is not None:
            values = self.pairs.values[:, :, : self.blocks.inputs_count + 2]
            plain = Pairs(values=values, failed=self.pairs.failed)
        paired = self.size - self.tabled.taken
        return Shared(sensitivity=answers, stopped=course.stopped, pairs=plain,
                      tabled=replace(self.tabled, paired=paired), carried=carried)  # fmt: skip


def _why_none(work: Work, sampled: Sampled) -> tuple[str, str]:
    """Why classical indices are not sought, and how their stages are said to have ended; empty where they are."""
    if not work.scene_names:
        return "no input of the model is random", "accuracy"
    tied, lost = dependent_names(work), lost_designs(sampled.sample.failed)
    if lost and (tied or not work.study.black_box or not _answered_quantities(work, sampled.sample)):
        return lost, "failures"
    if tied:
        reason = (
            f"{', '.join(tied)} depend on each other, and Sobol' indices do not share out the variance of "
            "dependent inputs: read Shapley effects and Kucherenko's indices, or remove the dependence to see what "
            "each would do alone"
        )
        return reason, "accuracy"
    return "", ""


def _answered_quantities(work: Work, sample: Sample) -> tuple[str, ...]:
    """The outputs of a black box whose indices its failures leave: those of all rows, where the rest lack too many."""
    lost = {q: sample.lost(q) for q in work.quantities}
    few = [q for q, rows in lost.items() if not lost_designs(rows)]
    together = np.any([lost[q] for q in few], axis=0) if few else np.zeros(1, dtype=bool)
    return tuple(q for q in few if not lost_designs(together) or not lost[q].any())


def _refused(work: Work, quantity: str, reason: str, *, missed: bool) -> Sensitivity:
    """No index of a quantity, and why; missed where a study whose runs all answer would have them."""
    said = [Missed(subject=quantity, kind="indices", said=f"{quantity}: indices: none: {reason}")] if missed else []
    return Sensitivity.none(work.scene_names, absent(reason, METHOD, 0), missed=said)


def find_sensitivity(work: Work, sampled: Sampled) -> Shared:
    """Indices of every quantity, or why there are none; what one output of a black box lacks takes none from others."""
    reason, stopped = _why_none(work, sampled)
    if reason:
        refused = {q: _refused(work, q, reason, missed=stopped == "failures") for q in work.quantities}
        return Shared(sensitivity=refused, stopped=stopped)
    kept = _answered_quantities(work, sampled.sample) if lost_designs(sampled.sample.failed) else work.quantities
    shared = _find_shares(work if kept == work.quantities else replace(work, columns=kept), sampled)
    if kept == work.quantities:
        return shared
    every, pairs = shared.sensitivity, shared.pairs
    for q in set(work.quantities) - set(kept):
        every[q] = _refused(work, q, lost_designs(sampled.sample.lost(q)) or OTHERS_LOST, missed=True)
    if pairs is not None:
        values = np.full((*pairs.values.shape[:3], len(work.quantities)), np.nan)
        values[..., [work.quantities.index(q) for q in kept]] = pairs.values
        pairs = replace(pairs, values=values)
    return replace(shared, sensitivity={q: every[q] for q in work.quantities}, pairs=pairs)


def _find_shares(work: Work, sampled: Sampled) -> Shared:
    """Sobol' indices of every quantity, by pairs and by expansions."""
    methods = set(work.study.analysis.methods)
    expansions = dict.fromkeys(work.quantities, Expansion())
    if {"pce", "auto"} & methods:
        for quantity in work.quantities:
            found = expansions[quantity] = _expand(work, sampled, quantity)
            runs, error = found.about.evaluations, found.about.error
            work.tell(speed_rows_of(CHAOS, quantity, runs, error, HELD_OUT))
    question = Indices(work=work, expansions=expansions, blocks=blocks_of(work), tabled=sampled.tabled.again())
    return question.answer(campaign(work, question) if work.study.analysis.samples_indices else Course())


def _sets(drawn: SampledIndices) -> list[Estimate]:
    """Indices of pairs and of groups."""
    return [*drawn.second.values(), *drawn.group_first, *drawn.group_total]


def without_sets(work: Work, indices: Sensitivity, nothing: Estimate) -> Sensitivity:
    """The same with no index of the pairs and groups that the study asks for, and why."""
    names, analysis = work.scene_names, work.study.analysis
    pairs = combinations(names, 2) if analysis.second_order else ()
    groups = dict.fromkeys(analysis.groups, nothing)
    return replace(indices, second={f"{a}|{b}": nothing for a, b in pairs}, group_first=groups, group_total=groups)


def _with_sets(
    work: Work, quantity: str, indices: Sensitivity, drawn: SampledIndices | None, asked: float, cost: Cost
) -> Sensitivity:
    """The same with the indices of pairs and groups that the study asks for."""
    names, analysis = work.scene_names, work.study.analysis
    if drawn is None:
        reason = "indices of pairs and groups are sampled, which was not asked for or is beyond the budget"
        return without_sets(work, indices, absent(reason, METHOD, 0))
    width = widest(_sets(drawn))
    said = f"{quantity}: indices of pairs and groups: half-width {told_apart(width, asked)}, asked {asked:g}"
    late = [Missed(subject=quantity, kind="indices", said=said, cost=cost)] if width > asked else []
    return replace(
        indices,
        second={f"{names[i]}|{names[j]}": e for (i, j), e in drawn.second.items()},
        group_first=dict(zip(analysis.groups, believable(drawn.group_first), strict=True)),
        group_total=dict(zip(analysis.groups, believable(drawn.group_total), strict=True)),
        estimators=drawn.text,
        missed=indices.missed + late,
    )


def _beside_salib(indices: Sensitivity, outputs: Array) -> Sensitivity:
    """The same with what SALib's estimators find on the same rows (R, N, d + 2)."""
    from uqsphere.uq.interop import salib_check

    agree, text = elsewhere(salib_check, tuple(indices.first), indices.sampled, outputs)()
    told = " ".join(part for part in (indices.text, text) if part)
    return replace(indices, text=told, agree=indices.agree if agree else False)


def _conclude(
    quantity: str,
    names: tuple[str, ...],
    sampled: dict[str, list[Estimate]],
    expansion: Expansion,
    asked: float,
    cost: Cost,
) -> Sensitivity:
    expanded, about = expansion.indices, expansion.about
    # What is sampled is the answer: of the model itself, with the expansion as control variate where there is one.
    given = sampled or expanded
    if not given:
        reason = about.reason or "no method that was asked for gives indices within the budget"
        missed = [indices_missed(quantity, None, asked, f": {reason}")]
        return Sensitivity.none(names, absent(reason, METHOD, 0), surrogate=about, missed=missed)
    agree: bool | None = None
    if sampled and expanded:
        agree, text = cross_check(list(names), sampled, expanded)
    elif about.kind and expanded:
        text = f"Indices are those of the polynomial chaos: {about.reason}. None were sampled that would check them."
    elif about.kind:
        text = f"The polynomial chaos is not used: {str(about.reason).removeprefix('refused: ')}. Indices are sampled."
    else:
        text = "Only one method was asked for."
    given = dict(zip(("first", "total"), ordered(given["first"], given["total"]), strict=True))
    width = widest(given["first"], given["total"])
    given = {order: believable(row) for order, row in given.items()}
    missed = [indices_missed(quantity, width, asked, cost=cost)] if width > asked else []
    return Sensitivity(
        first=dict(zip(names, given["first"], strict=True)),
        total=dict(zip(names, given["total"], strict=True)),
        surrogate=about,
        sampled=sampled,
        expanded=expanded,
        agree=agree,
        text=text,
        missed=missed,
    )
