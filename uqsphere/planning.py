"""The plan of a test: a map over striker speed and ramp, its edges, and the constraint that binds at every point.

The scene of a study stands at its means; what scatters is the strength.  Nineteen specimens stand for the batch, at
every twentieth of the strength's distribution from the 5 % to the 95 % fractile: a weak one breaks early, a strong one
late, and the test should serve both.  A specimen is at the same fractile of every limit.  The difference of the forces
swings, so that a test may find one strength in balance and the next one not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.errors import UsageError
from uqsphere.mechanics.bars import wave_speed
from uqsphere.mechanics.design import (
    CONSTRAINTS,
    Breaks,
    Rig,
    binding,
    break_on_ramp,
    first_return,
    over_onset,
    ramp_scene,
    shortest_striker,
    usages,
)
from uqsphere.mechanics.outputs import Path, path_of
from uqsphere.mechanics.scene import STATUS, Scene, answered
from uqsphere.mechanics.validity import grades_of
from uqsphere.model import scene_of, solve_scene
from uqsphere.report.figures.canvas import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PAPER,
    PURPLE,
    RED,
    SKY,
    Picture,
    log_axis,
    new_figure,
    render,
    shorten,
    style,
)
from uqsphere.study import SPEED, Limit, Study
from uqsphere.uq import Law

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

#: where in the distribution of the strength the specimens of a batch are
FRACTILES: Final = tuple(float(k) / 20.0 for k in range(1, 20))
#: ramps whose windows are listed, and halvings that place an edge between two speeds of the map
LISTED: Final = 9
HALVINGS: Final = 12
#: relative step in which a laboratory sets the speed of a striker: shots repeat within about 1 % (as standard
#: deviation; general literature on gas guns), so that less than twice that is not set but met by chance
SETTING: Final = 0.02
#: pulses that follow from a striker and a ramp
SHAPES: Final = ("rectangular", "ramp", "trapezoid")
#: longest ramp where none is asked for [s]
_LONGEST: Final = 200e-6
#: which specimens a window is for
SPECIMENS: Final = ("quantile", "batch")


@dataclass(frozen=True, kw_only=True)
class Request:
    """What is asked: ranges of speed [m/s] and ramp [s], striker lengths [m], largest difference of the forces over
    the largest so far, the quantile of the strength, and points of the map in speed and ramp."""

    speeds: tuple[float, float]
    rises: tuple[float, float]
    lengths: tuple[float, ...]
    level: float = 0.1
    quantile: float = 0.5
    grid: tuple[int, int] = (60, 41)


@dataclass(frozen=True, kw_only=True)
class Subject:
    """The sphere and rig of a study: numbers at their means, limits with their paths, strengths (m, L) at m fractiles.

    `place` is the fractile that is asked for, `batch` those that stand for the batch.
    """

    columns: Mapping[str, float]
    rigid_contact: bool
    dents: bool
    demands: Mapping[str, tuple[str, Mapping[str, float]]]
    limits: tuple[Limit, ...]
    paths: tuple[Path, ...]
    fractiles: Array
    strengths: Array
    place: int
    batch: tuple[int, ...]
    fidelity: str
    fall: float
    first_return: float
    round_trip: float


@dataclass(frozen=True, kw_only=True)
class Window:
    """Speeds [m/s] at which every constraint is kept under one ramp [s], and what ends them below and above.

    `below` and `above` are None where the range that was asked for ends first.
    """

    kind: str
    rise: float
    low: float
    high: float
    below: str | None
    above: str | None


@dataclass(frozen=True, kw_only=True)
class Chart:
    """The map of one striker length [m]; arrays (R, S, m) over ramps, speeds and fractiles.

    `used` is the usage of every constraint, `binds` the place of the one that binds (-1: not computed), `kept` whether
    all are kept.  `nearest` tells for a listed ramp without a window what is in its way.
    """

    length: float
    used: Mapping[str, Array]
    binds: Places
    kept: Flags
    windows: tuple[Window, ...]
    nearest: Mapping[tuple[str, float], str]


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A map for every striker length, over speeds (S,) [m/s] and ramps (R,) [s].

    `breaks`, `transits` and `shortest` (R, S, m) hold for all lengths: the fracture under a pulse that lasts, waves
    that have crossed the sphere by then, and the least striker length [m] whose pulse lasts until then. `over_onset` is
    the pressure by Hertz at the fracture over the onset of bars or inserts, nan where no onset is known.
    """

    request: Request
    subject: Subject
    speeds: Array
    rises: Array
    listed: tuple[float, ...]
    breaks: Breaks
    transits: Array
    over_onset: Array
    shortest: Array
    charts: tuple[Chart, ...]


def fracture_limits(study: Study) -> list[tuple[Limit, Path]]:
    """The limits that mean fracture, with the paths of their demands; refused where there is none."""
    if not study.limits:
        raise UsageError("a plan needs to know when the sphere breaks: give the study a limit, [limits.NAME]")
    found = [(limit, path_of(limit.quantity, study.demands)) for limit in study.limits if limit.fracture is not False]
    paths = [(limit, path) for limit, path in found if path is not None]
    if not paths:
        raise UsageError("no limit of the study means fracture: a plan needs one of force, pressure, stress or energy")
    return paths


def _check(study: Study) -> None:
    if study.black_box:
        raise UsageError("a test is planned for a sphere between bars; this study is a black box")
    shape = str(study.options["pulse.shape"])
    if shape not in SHAPES:
        raise UsageError(
            f"a plan varies striker and ramp, which a {shape} pulse does not follow from "
            f"(allowed: {', '.join(SHAPES)}; "
            "--set 'pulse={shape=\"rectangular\"}' puts one in place)"
        )
    fracture_limits(study)


def strength_at(limit: Limit, fractiles: Array) -> Array:
    """Strength over the model's factor, which stands at its median."""
    factor = limit.model_factor.median() if isinstance(limit.model_factor, Law) else limit.model_factor
    if isinstance(limit.strength, Law):
        return np.asarray(limit.strength.ppf(fractiles) / factor)
    return np.full(len(fractiles), limit.strength / factor)


def subject_of(study: Study, quantile: float = 0.5) -> Subject:
    """What is to be broken, and in which rig.

    Raises UsageError for a black box, a study without a limit that means fracture, a pulse that does not follow from a
    striker and a ramp, or a scene outside the domain of the model.
    """
    _check(study)
    limits, paths = zip(*fracture_limits(study), strict=True)
    scatter = any(isinstance(limit.strength, Law) for limit in limits)
    fractiles = np.unique([*FRACTILES, quantile]) if scatter else np.array([quantile])
    scene = scene_of(study, {}, 1, over_frequency=True)
    if scene.status[0] == 1:
        raise UsageError(f"this scene cannot be computed: {STATUS[1]}")
    returned, round_trip = first_return(scene)
    return Subject(
        columns={name: float(column[0]) for name, column in scene.columns.items()},
        rigid_contact=scene.rigid_contact,
        dents=scene.contact_law == "plastic",
        demands=study.demands,
        limits=limits,
        paths=paths,
        fractiles=fractiles,
        strengths=np.stack([strength_at(limit, fractiles) for limit in limits], axis=1),
        place=int(np.flatnonzero(fractiles == quantile)[0]),
        batch=tuple(int(k) for k in np.flatnonzero(np.isin(fractiles, FRACTILES))) if scatter else (0,),
        fidelity="massless" if study.model.fidelity == "massless" else "full",
        fall=float(scene.column("pulse.fall", 0.0)[0]) if scene.shape == "trapezoid" else 0.0,
        first_return=returned,
        round_trip=round_trip,
    )


def _below(value: float) -> float:
    """The largest of 1, 2, 4, 5 and 8 times a power of ten that is not above `value`.

    >>> _below(155.0), _below(1e-4)
    (100.0, 0.0001)
    """
    power = 10.0 ** np.floor(np.log10(value) + 1e-9)
    return float(max(step * power for step in (1.0, 2.0, 4.0, 5.0, 8.0) if step * power <= value * (1.0 + 1e-9)))


def request_of(
    study: Study,
    *,
    speeds: tuple[float, float] | None = None,
    rises: tuple[float, float] | None = None,
    lengths: Sequence[float] | None = None,
    level: float = 0.1,
    quantile: float = 0.5,
    grid: tuple[int, int] = (60, 41),
) -> Request:
    """A request with what is left out taken from the study.

    Speeds: those of its margins, or a decade to either side of its own.  Lengths: its own.  Ramps: up to the pulse of
    the longest striker or the first return of a reflection, at most 200 us.

    Raises UsageError as `subject_of`, or where the study does not have what is left out.
    """
    _check(study)
    scene = scene_of(study, {}, 1, over_frequency=True)
    c = {name: float(column[0]) for name, column in scene.columns.items()}
    if lengths is None:
        if "striker.length" not in c or "pulse.duration" in c:
            raise UsageError("the study gives its pulse without a striker's length: ask for some by --length")
        lengths = (c["striker.length"],)
    if speeds is None:
        asked = study.margins
        own = c["striker.speed"]
        speeds = (asked.axis.low, asked.axis.high) if asked and asked.axis.path == SPEED else (0.1 * own, 10.0 * own)
    if rises is None:
        speed = wave_speed(*(c.get(f"striker.{key}", c[f"bars.{key}"]) for key in ("E", "density")))
        rises = (0.0, _below(min(2.0 * max(lengths) / speed, first_return(scene)[0], _LONGEST)))
    return Request(speeds=speeds, rises=rises, lengths=tuple(lengths), level=level, quantile=quantile,
                   grid=grid)  # fmt: skip


def judge_points(
    subject: Subject, request: Request, speeds: Array, rises: Array
) -> tuple[Scene, Breaks, list[dict[str, Array]]]:
    """Fracture at n points of speed [m/s] and ramp [s], and the usages (n, m) for every length of the request."""
    columns = {name: np.full(len(speeds), value) for name, value in subject.columns.items()} | {"striker.speed": speeds}
    law = "plastic" if subject.dents else "hertz"
    scene = ramp_scene(columns, rises, rigid_contact=subject.rigid_contact, demands=subject.demands, law=law)
    names = [limit.quantity for limit in subject.limits]
    breaks = break_on_ramp(scene, names, subject.paths, subject.strengths, fidelity=subject.fidelity)
    rigs = (
        Rig(length=length, fall=subject.fall, level=request.level, first_return=subject.first_return,
            round_trip=subject.round_trip, dents=subject.dents) for length in request.lengths
    )  # fmt: skip
    return scene, breaks, [usages(scene, breaks, rig) for rig in rigs]


def plan_test(study: Study, request: Request) -> Plan:
    """The map of a test, a chart for every striker length.

    Raises UsageError as `subject_of`.
    """
    subject = subject_of(study, request.quantile)
    count, ramps = request.grid
    speeds, rises = np.geomspace(*request.speeds, count), np.linspace(*request.rises, ramps)
    every_rise, every_speed = (axis.ravel() for axis in np.meshgrid(rises, speeds, indexing="ij"))
    scene, breaks, used = judge_points(subject, request, every_speed, every_rise)
    shape = (ramps, count, len(subject.fractiles))
    c = subject.columns
    transit = 2.0 * c["sphere.radius"] / wave_speed(c["sphere.E"], c["sphere.density"])
    maps = [{name: values.reshape(shape) for name, values in one.items()} for one in used]
    places = np.unique(np.linspace(0, ramps - 1, min(LISTED, ramps)).round().astype(int))
    listed = rises[places]
    # speeds of a listed ramp for each one of the map, so that a narrow window is not stepped over
    windows, nearest = _windows(subject, request, np.geomspace(*request.speeds, 2 * (count - 1) + 1), listed)
    charts = []
    for length, one, own, near in zip(request.lengths, maps, windows, nearest, strict=True):
        binds, kept = binding(one)
        charts.append(Chart(length=length, used=one, binds=binds, kept=kept, windows=tuple(own), nearest=near))
    return Plan(
        request=request, subject=subject, speeds=speeds, rises=rises, listed=tuple(listed.tolist()),
        breaks=Breaks(**{field.name: getattr(breaks, field.name).reshape(shape) for field in fields(breaks)}),
        transits=(breaks.time / transit).reshape(shape),
        over_onset=over_onset(scene, breaks).reshape(shape),
        shortest=shortest_striker(scene, breaks, subject.fall).reshape(shape),
        charts=tuple(charts),
    )  # fmt: skip


def _of_kind(subject: Subject, kind: str) -> list[int]:
    """Fractiles that a window of a kind has to hold for."""
    return [subject.place] if kind == "quantile" else list(subject.batch)


def _largest(used: Mapping[str, Array]) -> Array:
    """The usage that binds, larger than all others where the sphere does not break or is not computed."""
    stacked = np.stack([np.where(np.isnan(values), -np.inf, values) for values in used.values()])
    return np.where(np.isnan(used["speed"]), np.inf, stacked.max(axis=0))


def _name(place: int) -> str:
    return "not computed" if place < 0 else list(CONSTRAINTS)[place]


def _in_the_way(used: Mapping[str, Array], at: list[int]) -> str:
    """What is broken at the speed that comes nearest to a window; usages (S, m) of one ramp, `at` those that count."""
    worst = _largest(used)[:, at]
    s = int(worst.max(axis=1).argmin())
    return _name(int(binding(used)[0][s, at[int(worst[s].argmax())]]))


def _runs(kept: Flags) -> list[tuple[int, int]]:
    """First and last places of the runs of True."""
    change = np.flatnonzero(np.diff(np.concatenate([[0], kept.astype(int), [0]])))
    return [(begin, end - 1) for begin, end in change.reshape(-1, 2).tolist()]


def _windows(
    subject: Subject, request: Request, speeds: Array, rises: Array
) -> tuple[list[list[Window]], list[dict[tuple[str, float], str]]]:
    """Windows of the listed ramps for every length, their edges placed by halving; what is in the way of the others."""
    every_rise, every_speed = (axis.ravel() for axis in np.meshgrid(rises, speeds, indexing="ij"))
    _, _, judged = judge_points(subject, request, every_speed, every_rise)
    runs: dict[tuple[int, str, float], list[tuple[int, int]]] = {}
    nearest: list[dict[tuple[str, float], str]] = [{} for _ in judged]
    for chart, flat in enumerate(judged):
        used = {name: values.reshape(len(rises), len(speeds), -1) for name, values in flat.items()}
        kept = binding(used)[1]
        for kind in SPECIMENS:
            at = _of_kind(subject, kind)
            for r, rise in enumerate(rises.tolist()):
                runs[chart, kind, rise] = _runs(kept[r][:, at].all(axis=1))
                if not runs[chart, kind, rise]:
                    nearest[chart][kind, rise] = _in_the_way({name: values[r] for name, values in used.items()}, at)
    return _between(subject, request, speeds, runs, len(judged)), nearest


def _between(
    subject: Subject,
    request: Request,
    speeds: Array,
    runs: Mapping[tuple[int, str, float], Sequence[tuple[int, int]]],
    charts: int,
) -> list[list[Window]]:
    """Windows of every chart, from runs of speeds at which all is kept; the ends of the speeds have no edge."""
    edges = [
        _Edge(chart=chart, kind=kind, rise=rise, inner=float(speeds[inner]), outer=float(speeds[outer]))
        for (chart, kind, rise), own in runs.items()
        for begin, end in own
        for inner, outer in ((begin, begin - 1), (end, end + 1))
        if 0 <= outer < len(speeds)
    ]
    places: Iterator[tuple[float, str | None]] = iter(_place(subject, request, edges))
    windows: list[list[Window]] = [[] for _ in range(charts)]
    for (chart, kind, rise), own in runs.items():
        made = []
        for begin, end in own:
            low, below = next(places) if begin > 0 else (float(speeds[0]), None)
            high, above = next(places) if end + 1 < len(speeds) else (float(speeds[-1]), None)
            made.append(Window(kind=kind, rise=rise, low=low, high=high, below=below, above=above))
        windows[chart] += _settable(made)
    return windows


@dataclass(frozen=True, kw_only=True)
class _Edge:
    """A change between two speeds of the map, under one ramp, for one length and kind; all is kept at the inner one."""

    chart: int
    kind: str
    rise: float
    inner: float
    outer: float


def _settable(windows: list[Window]) -> list[Window]:
    """Windows of one ramp as a laboratory can use them: those across a gap too small to be set are one, and of several
    those too small to be set are none."""
    merged = windows[:1]
    for window in windows[1:]:
        if window.low < merged[-1].high * (1.0 + SETTING):
            merged[-1] = replace(merged[-1], high=window.high, above=window.above)
        else:
            merged.append(window)
    return [window for window in merged if window.high > window.low * (1.0 + SETTING)] or merged


def _place(subject: Subject, request: Request, edges: Sequence[_Edge]) -> list[tuple[float, str]]:
    """The speed of every edge, on its inner side, and the constraint that is broken beyond it."""
    if not edges:
        return []
    rises, inner, outer = np.array([(edge.rise, edge.inner, edge.outer) for edge in edges]).T
    names = [""] * len(edges)
    for turn in range(HALVINGS + 1):
        # the last turn asks what is broken just outside
        middle = np.sqrt(inner * outer) if turn < HALVINGS else outer
        _, _, used = judge_points(subject, request, middle, rises)
        judged = [(binding(one), _largest(one)) for one in used]
        held = np.zeros(len(edges), dtype=bool)
        for k, edge in enumerate(edges):
            (binds, kept), worst = judged[edge.chart]
            at = _of_kind(subject, edge.kind)
            held[k] = kept[k, at].all()
            names[k] = _name(int(binds[k, at[int(worst[k, at].argmax())]]))
        if turn < HALVINGS:
            inner, outer = np.where(held, middle, inner), np.where(held, outer, middle)
    return [(float(speed), name) for speed, name in zip(inner, names, strict=True)]


# --- a rig other than bars ----------------------------------------------------------------------------------
#
# Its speed, drop, force or displacement is moved: where along this one number the sphere breaks, and what checks say.

#: the one number of a rig, the first that it has
_NUMBERS: Final = ("rig.speed", "rig.drop_height", "hammer.speed", "hammer.drop_height", "platens.force",
                   "platens.displacement")  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Blow:
    """Values (S,) [SI] of the number at `path`, and what comes of each.

    `force` is the largest [N], `breaks` whether the sphere at the quantile asked for breaks, `share` how much of those
    at 5 to 95 % of the strength does, `grade` the worst of the checks (-1: no answer) and `check` which one that is.
    """

    path: str
    limits: tuple[Limit, ...]
    quantile: float
    values: Array
    force: Array
    breaks: Flags
    share: Array
    grade: Places
    check: tuple[str, ...]

    def first(self, where: Flags) -> float | None:
        """The least value from which on something holds to the end; None where it does not."""
        return float(self.values[np.flatnonzero(~where)[-1] + 1 if not where.all() else 0]) if where[-1] else None


def plan_blow(study: Study, *, quantile: float = 0.5, count: int = 60) -> Blow:
    """What breaks the sphere of a study in its rig, over the range of its margins or a decade to either side.

    Raises UsageError for a study without a rig of its own, or without a limit that means fracture.
    """
    if study.rig == "none":
        raise UsageError("a test is planned in the study's own rig, and this study has none but its services")
    found = fracture_limits(study)
    columns = scene_of(study, {}, 1).columns
    path = next(name for name in _NUMBERS if name in columns)
    own, asked = float(columns[path][0]), study.margins
    ends = (asked.axis.low, asked.axis.high) if asked is not None and asked.axis.path == path else (0.1 * own, 10 * own)
    values = np.geomspace(*ends, count)
    scene = scene_of(study, {path: values}, count)
    answers = solve_scene(scene, "full", tolerance=study.model.tolerance, threads=None, quantities=None)
    scatter = any(isinstance(limit.strength, Law) for limit, _ in found)
    fractiles = np.array([quantile, *(FRACTILES if scatter else ())])
    with np.errstate(invalid="ignore"):
        over = [answers.values[limit.quantity][:, None] > strength_at(limit, fractiles) for limit, _ in found]
    broken = np.any(over, axis=0)
    graded = grades_of(scene, answers)
    good, names, stacked = answered(answers.status), list(graded), np.stack(list(graded.values()))
    worst = np.where(good, stacked.max(axis=0), -1)
    check = [names[k] if grade > 1 else "" for k, grade in zip(stacked.argmax(axis=0), worst, strict=True)]
    return Blow(
        path=path, limits=tuple(limit for limit, _ in found), quantile=quantile, values=values,
        force=answers.values["P_max"], breaks=broken[:, 0] & good,
        share=broken[:, 1 if scatter else 0 :].mean(axis=1), grade=worst, check=tuple(check),
    )  # fmt: skip


# --- the map as a figure -------------------------------------------------------------------------------------------

#: colour, hatch and words of the fields of the map
_FIELDS: Final[dict[str, tuple[str, str, str]]] = {
    "speed": (GREY, "", "force too small"),
    "reflection": (SKY, "////", "reflection first"),
    "length": (BLUE, "---", "pulse too short"),
    "equilibrium": (ORANGE, "\\\\\\\\", "no equilibrium"),
    "pulse_yield": (RED, "xxx", "bars yield in the pulse"),
    "contact_yield": (PURPLE, "+++", "bars yield under the sphere"),
    "striker": (INK, "|||", "striker still on the bar"),
    "not computed": (INK, "**", "not computed"),
}


def plan_figure(found: Plan, which: int, title: str) -> str:
    """SVG text: the map of one striker length over speed and ramp, for the specimen that is asked for and the batch."""
    chart, subject = found.charts[which], found.subject
    at, batch = subject.place, list(subject.batch)
    names = [*CONSTRAINTS, "not computed"]
    places = np.where(chart.binds[:, :, at] < 0, len(CONSTRAINTS), chart.binds[:, :, at])
    kept, whole = chart.kept[:, :, at], chart.kept[:, :, batch].all(axis=2)
    speed, rise = found.speeds, found.rises * 1e6
    with style():
        from matplotlib.collections import PolyCollection
        from matplotlib.colors import to_rgb
        from matplotlib.patches import Patch

        figure, (axes,) = new_figure(4.9)
        handles: list[Artist] = []
        edges_v = np.concatenate([speed[:1], np.sqrt(speed[1:] * speed[:-1]), speed[-1:]])
        edges_r = np.concatenate([rise[:1], 0.5 * (rise[1:] + rise[:-1]), rise[-1:]])
        scatter = len(batch) > 1
        fields = [(whole, GREEN, "", 0.85, "all kept, strengths from 5 to 95 %" if scatter else "all kept")]
        if scatter:
            fields.append((kept & ~whole, GREEN, "", 0.35, f"kept at quantile {found.request.quantile:g} alone"))
        fields += [
            (~kept & ~whole & (places == k), _FIELDS[name][0], _FIELDS[name][1], 0.22, _FIELDS[name][2])
            for k, name in enumerate(names)
        ]
        for where, colour, hatch, alpha, words in fields:
            if not where.any():
                continue
            # on white and solid, so that neighbours leave no seam
            red, green, blue = (alpha * part + 1.0 - alpha for part in to_rgb(colour))
            fill = red, green, blue
            cells = _cells(np.asarray(where), edges_v, edges_r)
            axes.add_collection(PolyCollection(cells, facecolors=fill, edgecolors=fill, linewidths=0.3))
            if hatch:
                marks = axes.contourf(
                    speed, rise, where.astype(float), levels=[0.5, 1.5], colors="none", hatches=[hatch]
                )
                marks.set_edgecolor(GREY)
                marks.set_linewidth(0.0)
            handles.append(Patch(facecolor=fill, hatch=hatch, edgecolor=GREY, linewidth=0.5, label=words))
        _lengths(axes, speed, rise, found.shortest[:, :, at])
        own = subject.columns["striker.speed"], subject.columns.get("pulse.rise", 0.0) * 1e6
        if speed[0] <= own[0] <= speed[-1] and rise[0] <= own[1] <= rise[-1]:
            (mark,) = axes.plot(*own, linestyle="none", marker="D", markersize=6, markerfacecolor=PAPER,
                                markeredgecolor=INK, clip_on=False, zorder=5, label="the study")  # fmt: skip
            handles.append(mark)
        log_axis(axes, "x", float(speed[0]), float(speed[-1]))
        axes.set_ylim(rise[0], rise[-1])
        axes.set_xlabel("striker speed [m/s]")
        axes.set_ylabel("rise of the pulse [µs]")
        axes.set_title(
            f"{shorten(title, 60)}; striker of {chart.length:.3g} m\n"
            f"|P_A \u2212 P_B| at fracture at most {found.request.level:.3g} of the larger force"
        )
        figure.legend(handles=handles, loc="outside lower left", ncols=2)
    picture = Picture(name="plan", title=f"Plan of a test: {title}", finding=_finding(found, which), figure=figure)
    return render(picture)


def _finding(found: Plan, which: int) -> str:
    """The widest window in a sentence."""
    kind = "batch" if len(found.subject.batch) > 1 else "quantile"
    windows = [window for window in found.charts[which].windows if window.kind == kind]
    if not windows:
        return "No listed ramp has a speed at which every constraint is kept."
    best = max(windows, key=lambda window: window.high / window.low)
    return (f"The widest window is {best.low:.3g} to {best.high:.3g} m/s, under a ramp of {best.rise * 1e6:.4g} µs; "
            "dashed lines are the least lengths of the striker.")  # fmt: skip


def _cells(where: Flags, edges_v: Array, edges_r: Array) -> list[Array]:
    """Corners of the rectangles that cover the marked points, one for each run of them in a row."""
    found = []
    for r, row in enumerate(where):
        for begin, end in _runs(row):
            left, right, low, high = edges_v[begin], edges_v[end + 1], edges_r[r], edges_r[r + 1]
            found.append(np.array([(left, low), (right, low), (right, high), (left, high)]))
    return found


def _lengths(axes: Axes, speed: Array, rise: Array, shortest: Array) -> None:
    """Lines of equal least striker length over the part of the map where the sphere breaks."""
    from matplotlib.patheffects import withStroke

    known = np.ma.masked_invalid(shortest)
    if known.count() == 0 or known.max() <= known.min():
        return
    levels = [step * power for power in 10.0 ** np.arange(-4.0, 4.0) for step in (1.0, 2.0, 5.0)]
    inside = [level for level in levels if known.min() < level < known.max()]
    if not inside or min(shortest.shape) < 2:
        return
    lines = axes.contour(speed, rise, known, levels=inside, colors=INK, linewidths=0.7, linestyles="--")
    for text in axes.clabel(lines, fmt=lambda level: f"{level:g} m", fontsize=8):
        text.set_path_effects([withStroke(linewidth=2.5, foreground=PAPER)])
