"""A study over one or two of its keys: each point an ordinary run in a folder of its own.

One table and one chart show the number to use and the probability at the plan, as page and CSV.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING

from uqsphere.arrays import Names, frozen
from uqsphere.errors import UsageError
from uqsphere.quantities import display_unit, lookup
from uqsphere.results import Run, open_run
from uqsphere.results.folder import check_kind, owner_by_command, write_files
from uqsphere.results.types import Decision, Kind, Range, Results
from uqsphere.study import Study

from .figures import Picture, svg
from .format import capital, plain_name, small, with_unit
from .page import render
from .pictures import COLOURS
from .sentences import NO_LIMIT, DecisionText, as_event, chart_title, exceedance_name, joint_event
from .tables import PageTable, columns

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

#: keys of a sweep, and points of one
MOST_KEYS, MOST_POINTS = 2, 256
TABLE = "sweep.csv"
#: between numbers, the last with a unit: not behind a point or an exponent, nor before an exponent
#: alone
_DECIMAL_COMMA = re.compile(
    r"(?<![\w.])(?<![eE][+-])(\d+),(\d+(?:[eE][+-]?\d+)?\s?(?![eE][+-]?\d)[^\W\d][^,\"']*)"
)


def path_of(key: str) -> str:
    """The number that a key of a study sets.

    >>> path_of("striker.speed.mean"), path_of("inputs.load")
    ('striker.speed', 'load')
    """
    return key.removesuffix(".mean").removeprefix("inputs.")


@frozen
class Point:
    """One point of a sweep: the values of its keys as they were written, and its study."""

    values: Mapping[str, str]
    study: Study

    @property
    def name(self) -> str:
        """The name of its folder.

        >>> values = {"target.thickness": "10 mm", "rig.angle": "60 deg"}
        >>> Point(values=values, study=None).name
        'thickness-10-mm_angle-60-deg'
        """
        parts = []
        for key, text in self.values.items():
            last = path_of(key).rpartition(".")[2]
            parts.append(re.sub(r"[^\w.+-]+", "-", f"{last} {text}").strip("-"))
        return "_".join(parts)


@frozen
class Sweep:
    """A sweep: where it is kept, its points, and by their names the runs that there are."""

    title: str
    folder: Path
    owner: str
    keys: Names
    points: Sequence[Point]
    runs: dict[str, Run] = field(default_factory=dict)

    @property
    def meanings(self) -> list[str]:
        """What the keys set, in words."""
        return [lookup(path_of(key)).called for key in self.keys]


def plan_sweep(over: Names, folder: Path, load: Callable[[Names], Study]) -> Sweep:
    """The points of a sweep; every study of it is validated before the first one runs.

    over : ``KEY=VALUE, VALUE, ...`` once or twice; load : gives the study with ``KEY=VALUE`` set

    Raises UsageError for keys or values that make no sweep, StudyError for a point whose study is
    invalid, FolderError for a folder that holds something else.
    """
    grid = _grid(over)
    count = math.prod(map(len, grid.values()))
    if count > MOST_POINTS:
        raise UsageError(f"--over gives {count} points; at most {MOST_POINTS}")
    points = {}
    for texts in itertools.product(*grid.values()):
        values = dict(zip(grid, texts, strict=True))
        study = load([f"{key}={text}" for key, text in values.items()])
        point = Point(values=values, study=study)
        if point.name in points:
            raise UsageError(f"--over: two points have the same folder name, {point.name}")
        points[point.name] = point
    owner = owner_by_command("sweep", study.path)
    check_kind(folder, owner)
    return Sweep(
        title=study.title,
        folder=folder,
        owner=owner,
        keys=tuple(grid),
        points=[*points.values()],
    )


def _grid(over: Names) -> dict[str, list[str]]:
    grid = {}
    for text in over:
        key, _, listed = map(str.strip, text.partition("="))
        comma = _DECIMAL_COMMA.search(listed)
        if comma:
            raise UsageError(
                f"--over {text!r}: a decimal comma? Write {comma[1]}.{comma[2]}, and the unit of "
                "every value"
            )
        values = [part.strip().strip("\"'") for part in listed.split(",")]
        if not key or "" in values:
            raise UsageError(
                f"--over must be KEY=VALUES, for example "
                f'target.thickness="10 mm, 15 mm", not {text!r}'
            )
        if key in grid or len(set(values)) < len(values):
            raise UsageError(f"--over {text!r}: a key or a value is given twice")
        grid[key] = values
    if len(grid) > MOST_KEYS:
        raise UsageError(f"--over takes at most {MOST_KEYS} keys, not {len(grid)}")
    return grid


def finished_run(sweep: Sweep, point: Point) -> Run | None:
    """The run of a point that an earlier call has finished; None if it is still to be run."""
    folder = sweep.folder / point.name
    if not (folder / "results.json").exists():
        return None
    run = open_run(folder)
    results = run.results
    if results.study.hash != point.study.hash or results.accuracy.stopped == "interrupted":
        return None
    return run


def write_sweep(sweep: Sweep) -> Path:
    """Write table and page of the points that have run; returns the page's place."""
    frame = sweep_table(sweep)
    pictures = _pictures(sweep, frame)
    html = render(
        "sweep.html",
        title=f"{sweep.title}: sweep",
        keys=sweep.meanings,
        done=len(sweep.runs),
        planned=len(sweep.points),
        pictures=pictures,
        decisions=_decisions(sweep),
        no_limit=NO_LIMIT,
        points=[point.name for point in sweep.points if point.name in sweep.runs],
    )
    files = {f"figures/{name}.svg": picture.svg for name, picture in pictures.items()}
    files |= {TABLE: frame.to_csv(index=False), "report.html": html}
    write_files(sweep.folder, files, sweep.owner)
    return sweep.folder / "report.html"


def sweep_table(sweep: Sweep) -> pd.DataFrame:
    """One row a point and decision, SI units.

    Columns: the keys as they were written, aim, use, use_low, use_high (the number to use, and the
    range of its best estimate), probability, low, high, low_unseen, high_unseen (of fracture, or of
    exceedance, at the plan; the last two as in answers.csv), verdict, governing, runs, folder.
    """
    import pandas as pd

    rows = []
    for point, results, decision in _each(sweep):
        use: list[float | None] = [None, None, None]
        if decision.use:
            use = [decision.use.value, decision.use.best.low, decision.use.best.high]
        p = joint_event(decision)
        (row,) = results.where(f"decision.{decision.aim}", Kind.FAILURE_PROBABILITY)
        unseen = Range(low=row.low_unseen, high=row.high_unseen)
        outer = as_event(decision.aim, unseen)
        ends = (p.value, p.low, p.high, outer.low, outer.high)
        verdict = (decision.verdict, decision.governing, results.accuracy.runs, point.name)
        rows.append([*point.values.values(), decision.aim, *use, *ends, *verdict])
    names = (
        "aim use use_low use_high probability low high low_unseen high_unseen verdict governing "
        "runs folder"
    )
    return pd.DataFrame(rows, columns=[*sweep.keys, *names.split()])


def _each(sweep: Sweep) -> Iterator[tuple[Point, Results, Decision]]:
    """Every decision of a point that has run."""
    for point in sweep.points:
        if point.name in sweep.runs:
            results = sweep.runs[point.name].results
            for decision in results.decisions:
                yield point, results, decision


def _decisions(sweep: Sweep) -> PageTable:
    """One row a point and decision, as text."""
    rows = []
    event = ""
    for point, results, decision in _each(sweep):
        event = exceedance_name(results)
        text = DecisionText(results, decision)
        governs = plain_name(decision.governing)
        told = (text.use, text.together, decision.verdict, governs)
        rows.append((*point.values.values(), *told))
    if not rows:
        return PageTable()
    head = (*sweep.keys, "decision", f"{event} at the plan", "verdict", "governs")
    return PageTable("Decisions", head, rows)


def sweep_text(sweep: Sweep, width: int) -> str:
    """The table of a sweep for a terminal."""
    table = _decisions(sweep)
    lines = [NO_LIMIT]
    if table.rows:
        lines = columns([table.head, *table.rows], width)
    return "\n".join([sweep.title, "", *lines])


def _pictures(sweep: Sweep, frame: pd.DataFrame) -> dict[str, Picture]:
    """The number to use, and the probability at the plan, over the first key."""
    pictures = {}
    if frame.empty:
        return {}
    first = next(iter(sweep.runs.values())).results
    shown = [("sweep-plan", f"{chart_title(first)} at the plan", "probability", "%", 100.0)]
    if first.study.free:
        scale = display_unit(first.study.free.quantity, frame["use"].astype(float).max())
        title = f"{capital(first.study.free.meaning)} to use"
        shown.insert(0, ("sweep-use", title, "use", *scale))
    for name, title, column, unit, factor in shown:
        values = factor * frame[column].astype(float)
        label = with_unit(small(title), unit)
        drawn = svg(_draw, sweep, frame.assign(shown=values), label, size=(420.0, 270.0))
        text = f"{title}: the numbers are in the table"
        pictures[name] = Picture(with_unit(title, unit), text, drawn)
    return pictures


def _draw(axes: Axes, sweep: Sweep, frame: pd.DataFrame, label: str) -> None:
    """What is `shown`, and its label, over the first key: a line for each value of the second, and
    each aim.
    """
    key, *others = sweep.keys
    places = _places(sweep)
    names = sweep.meanings
    if frame["aim"].nunique() > 1:
        others.append("aim")
        names.append("to")
    groups = frame.groupby(others or ["aim"], sort=False)
    for colour, (group, rows) in zip(itertools.cycle(COLOURS), groups, strict=False):
        text = ", ".join(map(str, group))
        axes.plot(rows[key].map(places), rows["shown"], "o-", color=colour, label=text)
    axes.set_xticks(list(places.values()), list(places))
    axes.set(xlabel=names[0], ylabel=label)
    if others:
        axes.legend(title=", ".join(names[1:]), fontsize="small", title_fontsize="small")


def _places(sweep: Sweep) -> dict[str, float]:
    """Where the values of the first key stand on its axis: at their number, else one after the
    other.
    """
    places: dict[str, float] = {}
    key = sweep.keys[0]
    path = path_of(key)
    for point in sweep.points:
        place = point.study.fixed.get(path, float(len(places)))
        if path in point.study.random:
            place = point.study.random[path].mean()
        places.setdefault(point.values[key], place)
    return places
