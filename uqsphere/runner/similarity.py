"""The model as a function of the scaled numbers through which its inputs act: a table of them, and rows answered by it.

The scaled answers of a scene depend on nothing but what the integrator is given, in scaled variables: the mass number,
the pulse and the round trips over t_c, the laws of the faces.  Of these only some vary, and of those only some
independently of the others: as many as the derivatives of their logarithms by the random inputs have as rank.  Up to
three, whitened, are the coordinates of a table of the scaled answers (`uqsphere.uq.table`), which serves every quantity
at once: the scales of a row are known exactly.  A node is a scene with such numbers, found by Newton's iteration in as
many of the inputs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.model import as_integrated, scene_of
from uqsphere.results import Fields
from uqsphere.runner.campaign import rounded
from uqsphere.runner.chunks import remembered
from uqsphere.runner.evaluate import OutOfBudget, Work, draw, evaluate_points
from uqsphere.runner.schedule import TABLE
from uqsphere.uq.table import Table, make_table

if TYPE_CHECKING:
    from uqsphere.mechanics.scene import Scene

#: most numbers that a table is made for
MOST_NUMBERS: Final = 3
#: rows that say where the table is asked
ROWS: Final = 32_768
#: the first of them tell what each scaled answer matters
WEIGHED: Final = 256
#: share of the rows near jumps above which a table spares too little
MOST_OPEN: Final = 0.05
#: rows at which derivatives are taken, their step over the scatter, and the smallest part of the largest singular value
#: that tells a number that varies by itself from the rounding of differences
PROBES, STEP, RANK = 16, 1e-4, 1e-5
#: Newton's steps, and how well the numbers of a scene are met
NEWTON, MET = 12, 1e-9
#: times that the points of a table grow by, and the fall of the widest half-width below which it does not hang on them:
#: random ones give 0.7
FASTER, GAINED = 2, 0.9
CUT_SHORT: Final = "the table of scaled numbers was cut short by the time budget"
#: the integrator's arguments in the order in which they are preferred as coordinates, and what they are called
NUMBERS: Final = {
    "mass": "the mass number mu",
    "pulse_end": "the length of the pulse over t_c",
    "round_trips": "a round trip over t_c",
    "laws": "a number of the law of a face",
    "rigs": "a number of what stands at a pole",
    "speed": "the speed at first touch over V_c",
    "ends": "what an end reflects",
    "breaks": "a time of the pulse over t_c",
    "coefficients": "a level of the pulse",
    "frequencies": "the frequency of the pulse times t_c",
    "horizon": "the end of the record over t_c",
}


@dataclass(frozen=True, kw_only=True)
class Numbers:
    """The scaled numbers that vary independently, as coordinates of about unit scatter.

    Attributes
    ----------
    names : what they are called.
    columns : which of `_scaled` they are; `logs`: of which the logarithm is taken.
    centre, spread : (k,) mean and (k, k) root of the covariance of these.
    handles : inputs by which a scene is given such numbers; `middle`: the others stand there.
    """

    names: tuple[str, ...]
    columns: tuple[int, ...]
    logs: Flags
    centre: Array
    spread: Array
    handles: tuple[int, ...]
    middle: Array

    def of(self, scaled: Array) -> Array:
        """Coordinates (n, k) of rows of `_scaled`."""
        return np.asarray(np.linalg.solve(self.spread, (self.raw(scaled) - self.centre).T).T)

    def raw(self, scaled: Array) -> Array:
        """The numbers themselves, or their logarithms, (n, k)."""
        found = scaled[:, list(self.columns)]
        with np.errstate(all="ignore"):
            return np.where(self.logs, np.log(np.abs(found)), found)


def _scene(work: Work, rows: Array) -> tuple[Scene, str]:
    values = {name: rows[:, k] for k, name in enumerate(work.row_names)}
    return as_integrated(scene_of(work.study, values, len(rows)), work.fidelity)


def _scaled(scene: Scene, fidelity: str) -> tuple[Array, list[str]]:
    """The integrator's arguments (n, K) of scenes, side by side, and which is which."""
    from uqsphere.mechanics.integrator.solve import scaled_arguments

    rows = np.arange(len(scene))
    given = scaled_arguments(scene, rows)
    kept = [name for name in NUMBERS if not (name == "mass" and fidelity == "massless")]
    parts = {name: given[name].reshape(len(rows), -1) for name in kept}
    names = [name for name, part in parts.items() for _ in range(part.shape[1])]
    return np.concatenate(list(parts.values()), axis=1), names


def _tracked(work: Work, scene: Scene) -> dict[str, int]:
    """The scaled answers that quantities are made of: name -> column of the integrator's."""
    from uqsphere.mechanics.integrator.tracked import SCALED
    from uqsphere.mechanics.outputs import OUTPUTS, roots_of, wishes

    wanted = wishes(work.quantities, scene.demands)
    names = {name for name, (_, bit) in SCALED.items() if bit & wanted or not bit}
    if scene.rig == "bars" and scene.struck.face is None:  # faces that are alike have no columns of their own
        censored = {OUTPUTS[name].censored for name in work.quantities if name in OUTPUTS}
        names &= roots_of(work.quantities, scene.demands) | censored | {"x_max", "ended"}
    return {name: SCALED[name][0] for name in sorted(names)}


def _quantities(work: Work, scene: Scene, fidelity: str, scaled: Array) -> Array:
    """Quantities (n, q) of scenes from their scaled answers, as `_tracked`; NaN where these are not known."""
    from uqsphere.mechanics.outputs import answers_from

    tracked = dict(zip(_tracked(work, scene), scaled.T, strict=True))
    said = answers_from(scene, tracked, scene.status, np.zeros(len(scene), dtype=np.int64),
                        linear=fidelity == "linear", quantities=work.quantities)  # fmt: skip
    return np.stack([said.values[name] for name in work.quantities], axis=1)


def integrated(work: Work) -> bool:
    """Whether the rows of a study are integrated, one by one and by one model."""
    from uqsphere.mechanics import closed_form

    if work.study.black_box or work.fallback is not None or not work.scene_names:
        return False
    middle = work.all_inputs.only(work.scene_names).physical(np.zeros((1, len(work.scene_names))))
    scene, fidelity = _scene(replace(work, along=()), middle)
    if scene.contact_law == "damage" or scene.rig == "platens":
        return False
    if scene.rig == "bars":
        return not closed_form.closed_form_applies(scene, fidelity)
    return not (fidelity == "massless" or closed_form.closed_form_rows(scene).any())


def find_numbers(work: Work, rows: Array) -> Numbers | int:
    """The numbers through which the inputs act, from rows (n, d) of these; how many where a table takes no so many."""
    from scipy.linalg import qr

    scaled, names = _scaled(*_scene(work, rows))
    finite = np.isfinite(scaled).all(axis=0)
    logs: Flags = np.asarray(finite & ((scaled > 0.0).all(axis=0) | (scaled < 0.0).all(axis=0)))
    probes, sd = rows[:: max(1, len(rows) // PROBES)][:PROBES], rows.std(axis=0)
    d = rows.shape[1]
    moved = probes[:, None, :] + STEP * sd * np.concatenate([np.zeros((1, d)), np.eye(d)])
    around = _scaled(*_scene(work, moved.reshape(-1, d)))[0].reshape(len(probes), d + 1, -1)
    with np.errstate(all="ignore"):
        around = np.where(logs, np.log(np.abs(around)), around)
        slopes = (around[:, 1:] - around[:, :1]).transpose(0, 2, 1) / STEP  # (probes, K, d)
    varying = np.flatnonzero(finite & (np.nan_to_num(np.abs(slopes)).max(axis=(0, 2)) > RANK))
    if not len(varying):
        return 0
    count = int(_ranks(slopes[:, varying]).max())
    if count > MOST_NUMBERS:
        return count
    chosen: list[int] = []
    for column in varying.tolist():
        if len(chosen) < count and _ranks(slopes[:, [*chosen, column]]).min() > len(chosen):
            chosen.append(column)
    if len(chosen) < count:
        return 0
    _, _, order = qr(slopes[0][chosen], pivoting=True)
    found = Numbers(
        names=tuple(NUMBERS[names[column]] for column in chosen), columns=tuple(chosen), logs=logs[chosen],
        centre=np.zeros(count), spread=np.eye(count), handles=tuple(order[:count].tolist()),
        middle=np.median(rows, axis=0),
    )  # fmt: skip
    raw = found.raw(scaled)
    found = replace(found, centre=raw.mean(axis=0), spread=np.linalg.cholesky(np.atleast_2d(np.cov(raw.T))))
    return found if _determined(work, found, probes, varying, logs) else 0


def _ranks(slopes: Array) -> Array:
    """Rank of the derivatives (probes, m, d) at every probe."""
    values = np.linalg.svd(slopes, compute_uv=False)
    return np.asarray((values > RANK * np.maximum(values[:, :1], 1.0)).sum(axis=1))


def _determined(work: Work, numbers: Numbers, probes: Array, varying: Places, logs: Flags) -> bool:
    """Whether scenes that share the coordinates share all that the integrator is given."""
    given = _scaled(*_scene(work, probes))[0]
    found = scenes_at(work, numbers, numbers.of(given))
    other = _scaled(*_scene(work, found))[0]
    with np.errstate(all="ignore"):
        gap = np.where(logs, np.log(np.abs(other / given)), other - given)[:, varying]
    return bool(np.isfinite(found).all() and np.abs(gap).max() < 1e-6)


def scenes_at(work: Work, numbers: Numbers, points: Array) -> Array:
    """Rows (n, d) of inputs whose numbers have these coordinates (n, k); NaN where there are none."""
    handles, n = list(numbers.handles), len(points)
    k, rows = len(handles), np.tile(numbers.middle, (n, 1))
    aim = numbers.centre + points @ numbers.spread.T
    positive = numbers.middle[handles] > 0.0
    unit = np.where(positive, 1.0, np.maximum(np.abs(numbers.middle[handles]), 1e-3))
    with np.errstate(all="ignore"):
        for _ in range(NEWTON):
            moved = np.repeat(rows[:, None, :], k + 1, axis=1)
            for j, handle in enumerate(handles):
                moved[:, j + 1, handle] += 1e-6 * (rows[:, handle] if positive[j] else unit[j])
            raw = numbers.raw(_scaled(*_scene(work, moved.reshape(n * (k + 1), -1)))[0]).reshape(n, k + 1, k)
            off = aim - raw[:, 0]
            if not (np.abs(off) > MET).any():
                break
            slopes = (raw[:, 1:] - raw[:, :1]).transpose(0, 2, 1) / 1e-6
            good = np.isfinite(slopes).all(axis=(1, 2)) & (np.abs(np.linalg.det(np.nan_to_num(slopes))) > 1e-12)
            rows[~good] = np.nan
            step = np.linalg.solve(slopes[good], off[good][:, :, None])[:, :, 0]
            old = rows[np.ix_(good, handles)]
            rows[np.ix_(good, handles)] = np.where(positive, old * np.exp(np.clip(step, -2.0, 2.0)), old + unit * step)
        rows[~(np.abs(off) < 1e3 * MET).all(axis=1)] = np.nan
    return rows


@dataclass(frozen=True, kw_only=True)
class Similarity:
    """A table of the scaled answers in the numbers through which the inputs act, in place of the model."""

    numbers: Numbers
    table: Table

    def told(self, work: Work, rows: Array) -> Array:
        """Quantities (n, q) of rows (n, d) by the table; NaN where that does not know."""
        from uqsphere.mechanics.integrator.solve import thread_count

        def answer(some: Array) -> Array:
            scene = _scene(work, some)
            return _quantities(work, *scene, self.table.at(self.numbers.of(_scaled(*scene)[0]))[0])

        with ThreadPoolExecutor(thread_count(work.threads)) as pool:
            parts = pool.map(answer, (rows[begin : begin + ROWS] for begin in range(0, len(rows), ROWS)))
            return np.concatenate(list(parts))

    def answers(self, work: Work, key: str, rows: Array) -> tuple[Array, Places]:
        """Quantities (n, q) of rows (n, d): of the table, and of the model where that does not know; and which."""
        found = self.told(work, rows)
        open_ = np.flatnonzero(~np.isfinite(found).all(axis=1))
        if len(open_):
            found[open_] = evaluate_points(work, key, work.row_names, rows[open_]).values
        return found, open_


def make_similarity(work: Work, rows: Array | None = None,
                    scores: Callable[[Array], Array] | None = None) -> Similarity | str:  # fmt: skip
    """The table of a study, or why there is none.

    rows : (n, d), where it is asked if not at the inputs' own
    scores : what is made of quantities (m, q) beside them, (m, s), that tells where it has to be fine, about of unit
        scatter
    """
    from uqsphere.mechanics.integrator.solve import integrate

    if not integrated(work):
        return "rows are not integrated one by one"
    if rows is None:
        inputs = work.all_inputs.only(work.scene_names)
        rows = draw(inputs, seed=work.study.seed, task="similarity", start=0, count=ROWS, replicates=1).inputs[0]
    numbers = find_numbers(work, rows)
    if isinstance(numbers, int):
        return f"the inputs act through {numbers} numbers that vary independently" if numbers else "no number varies"

    tracked = _tracked(work, _scene(work, rows[:1])[0])

    def evaluate(nodes: Array) -> Array:
        there = np.isfinite(nodes).all(axis=1)
        scene, fidelity = _scene(work, nodes[there])

        def solve() -> Array:
            found = integrate(scene, fidelity=fidelity, tolerance=work.study.model.tolerance, threads=work.threads,
                              quantities=work.quantities)  # fmt: skip
            return np.where((found.status == 0)[:, None], found.answers[:, list(tracked.values())], np.nan)

        work.ledger.evaluations[work.fidelity] = work.ledger.evaluations.get(work.fidelity, 0) + len(scene)
        about = [fidelity, work.study.model.tolerance, work.quantities]
        got = remembered(work.store, f"similarity.{len(scene)}", scene, about, solve, np.ndarray)
        values = np.full((len(nodes), len(tracked)), np.nan)
        values[there] = got
        return values

    coordinates = numbers.of(_scaled(*_scene(work, rows))[0])
    columns = len(work.quantities)
    if scores is None:
        weighed = evaluate(scenes_at(work, numbers, coordinates[:WEIGHED]))
        follow = _followed(work, numbers, rows[:WEIGHED], coordinates[:WEIGHED], weighed)
    else:
        columns = scores(np.ones((1, columns))).shape[1]

    def beside(points: Array) -> Array:
        nodes = scenes_at(work, numbers, points)
        scaled = evaluate(nodes)
        if scores is None:
            return follow.beside(work, points, scaled)
        scene, fidelity = _scene(work, np.where(np.isfinite(nodes), nodes, numbers.middle))
        return np.concatenate([scaled, scores(_quantities(work, scene, fidelity, scaled))], axis=1)

    table = make_table(coordinates, beside, columns, TABLE.most, MOST_OPEN)
    if (left := 1.0 - table.at(coordinates)[1].mean()) > MOST_OPEN:
        return f"it would leave {100.0 * left:.0f} % of the rows to the model, near jumps"
    return Similarity(numbers=numbers, table=table)


@dataclass(frozen=True, kw_only=True)
class _Followed:
    """What a table is made finer by: what the quantities would be at the scales of one scene, `middle`, over their
    scatter, less a straight line in the coordinates; of what is positive the logarithm.

    A contact as long as the pulse goes with 1/t_c, over t_c: what is straight is known in between.
    """

    middle: Array
    logs: Flags
    weights: Array
    lines: Array

    def bent(self, work: Work, scaled: Array) -> Array:
        """The quantities (m, q), or their logarithms."""
        found = _quantities(work, *_scene(work, np.tile(self.middle, (len(scaled), 1))), scaled)
        with np.errstate(all="ignore"):
            return np.where(self.logs, np.log(np.abs(found)), found)

    def beside(self, work: Work, points: Array, scaled: Array) -> Array:
        """Scaled answers (m, c) with what is followed beside them, (m, c + q)."""
        straight = self.lines[0] + points @ self.lines[1:]
        return np.concatenate([scaled, self.weights * (self.bent(work, scaled) - straight)], axis=1)


def _followed(work: Work, numbers: Numbers, rows: Array, points: Array, scaled: Array) -> _Followed:
    """What is followed, from some rows (n, d), their coordinates (n, k) and scaled answers (n, c)."""
    values = _quantities(work, *_scene(work, rows), scaled)
    known = np.isfinite(values).all(axis=1)
    values, points, scaled = values[known], points[known], scaled[known]
    logs: Flags = np.asarray((values > 0.0).all(axis=0))
    spread = np.maximum(values.std(axis=0), 1e-12 * np.abs(values).max(axis=0, initial=0.0))
    weights = np.where(logs, values.mean(axis=0), 1.0) / np.where(spread > 0.0, spread, np.inf)
    found = _Followed(middle=numbers.middle, logs=logs, weights=weights, lines=np.zeros((points.shape[1] + 1, 1)))
    columns = np.concatenate([np.ones((len(points), 1)), points], axis=1)
    return replace(found, lines=np.linalg.lstsq(columns, found.bent(work, scaled), rcond=None)[0])


# --- a table beside rows of the model -----------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Tabled:
    """A table beside a design of the model: how many points it was asked at, and what it took.

    `count` points of each replicate, the first of which are the model's, were asked for the `quantities` that it helps
    (all if there are none); `rows` is how many rows these are.  `taken` counts its evaluations, `open` those of rows
    that it left to the model, `paired` those of the model's own design; `forecast` is what sampling alone would take.
    `worst` is the largest half-width over what is asked after the last stage, `grows` whether the table is what grows
    next, `text` says why there is none.
    """

    similarity: Similarity | None = None
    text: str = ""
    quantities: tuple[str, ...] = ()
    count: int = 0
    rows: int = 0
    open: int = 0
    taken: int = 0
    paired: int = 0
    forecast: int = 0
    worst: float = math.inf
    grows: bool = True

    @property
    def begun(self) -> bool:
        """Whether it stands beside a design."""
        return self.similarity is not None and self.paired > 0

    def again(self) -> Tabled:
        """The same table before it is asked for anything, for another design."""
        return Tabled(similarity=self.similarity, text=self.text)

    def turned(self, worst: float) -> Tabled:
        """The same after a stage that left so large a half-width: what it made grow goes on growing where that helped,
        else the other does, the table or the rows of the model."""
        return replace(self, worst=worst, grows=self.grows == (worst <= GAINED * self.worst))

    def grown(self, points: int, room: float) -> int:
        """The points that are due next, beside so many of the model; 0 where more of the model's own are due."""
        count, most = FASTER * self.count, TABLE.judged * points
        return 0 if not self.count or not self.grows or count > most or (FASTER - 1) * self.open > room else count

    def asked(self, work: Work, key: str, rows: Array, count: int) -> tuple[Tabled, Array, Places]:
        """The same after further rows (n, d), with the quantities (n, q) there, and which are the model's.

        There is no table any more where the time was over.
        """
        assert self.similarity is not None
        try:
            values, open_ = self.similarity.answers(work, f"similarity-{key}.{self.count}", rows)
        except OutOfBudget:
            return Tabled(text=CUT_SHORT), np.empty((0, 0)), np.empty(0, dtype=np.int64)
        left = len(open_)
        found = replace(self, count=count, rows=self.rows + len(rows), open=self.open + left, taken=self.taken + left)
        return found, values, open_

    def told(self, of: str) -> str:
        """What it did, or why there is none."""
        if self.similarity is None or not self.rows:
            return self.text
        names, nodes = self.similarity.numbers.names, self.similarity.table.nodes
        several = len(names) > 1
        return (
            f"the inputs act through {len(names)} scaled number{'s' * several} ({', '.join(names)}); a table of "
            f"{nodes:,} points in {'them' if several else 'it'} answers {self.rows:,} rows for {of}; the model answers "
            f"{self.open:,} of them, where the table jumps"
        )


def begin_table(work: Work, before: Tabled, paired: int, forecast: float, room: float,
                make: Callable[[Work], Similarity | str] | None = None) -> Tabled:  # fmt: skip
    """A table beside so many rows of the model, where sampling alone would take more evaluations than that."""
    known, name = before.similarity, work.fidelity
    cost = 0 if known is not None else 2 * TABLE.most
    if before.text or not paired + cost < forecast or cost > room:
        return before.again()
    spent = work.ledger.evaluations.get(name, 0)
    try:
        made = known or (make or make_similarity)(work)
    except OutOfBudget:
        return Tabled(text=CUT_SHORT)
    if isinstance(made, str):
        return Tabled(text=f"no table of scaled numbers: {made}")
    taken = work.ledger.evaluations.get(name, 0) - spent
    return Tabled(similarity=made, taken=taken, paired=paired, forecast=int(min(forecast, 1e12)))


def _used(tables: Sequence[Tabled]) -> list[Tabled]:
    return [one for one in tables if one.similarity is not None and one.rows]


def table_entry(sampling: Tabled, indices: Tabled, curves: Sequence[Tabled]) -> Fields:
    """What is said of tables in results.json."""
    used = _used((sampling, indices, *curves))
    margins = "; ".join(dict.fromkeys(text for one in curves if (text := one.told("the curves"))))
    return {
        "used": bool(used),
        "fidelity": "table" if used else None,
        "ratio": used[0].rows / used[0].paired if used else None,
        "gain": {},
        "text": sampling.told("the distributions"),
        "indices": indices.told(f"the indices of {', '.join(indices.quantities)}"),
        **({"margins": margins} if margins else {}),
    }


def table_saved(tables: Sequence[Tabled]) -> Fields:
    """What tables saved, against the forecast of what sampling alone would take."""
    used = _used(tables)
    taken, forecast = sum(one.paired + one.taken for one in used), sum(one.forecast for one in used)
    if taken >= forecast:
        return {"full_evaluations": 0, "cost_share": 0.0, "text": "nothing is saved"}
    share = 1.0 - taken / forecast
    text = (
        f"{taken:,} evaluations in place of some {rounded(forecast):,} that sampling alone was forecast to take, "
        f"{100.0 * share:.0f} % of them"
    )
    return {"full_evaluations": forecast - taken, "cost_share": share, "text": text}
