"""A study over one or two of its keys: each point an ordinary run in a folder of its own.

One table and one chart show the number to use and the probability at the plan, as page and CSV.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.errors import FolderError, UsageError
from uqsphere.quantities import display_unit, lookup
from uqsphere.report.figures import COLOURS, Picture, svg
from uqsphere.report.format import capital, plain_probability, short, with_unit
from uqsphere.report.page import render
from uqsphere.report.sentences import (
    as_event,
    chart_title,
    decision_text,
    exceedance_name,
    plain_name,
)
from uqsphere.report.tables import PageTable, columns
from uqsphere.results import Run, open_run
from uqsphere.results.folder import write_files
from uqsphere.results.types import Decision, Range, Results
from uqsphere.study import Study

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

#: keys of a sweep, and points of one
MOST_KEYS, MOST_POINTS = 2, 256
TABLE: Final = "sweep.csv"


def path_of(key: str) -> str:
    """The number that a key of a study sets.

    >>> path_of("striker.speed.mean"), path_of("inputs.load")
    ('striker.speed', 'load')
    """
    return key.removesuffix(".mean").removeprefix("inputs.")


@dataclass(frozen=True, kw_only=True)
class Point:
    """One point of a sweep: the values of its keys as they were written, and its study."""

    values: Mapping[str, str]
    study: Study
    name: str

    def number(self, key: str) -> float | None:
        """The value of a key [SI]; None for one that is no number of the study."""
        path = path_of(key)
        if path in self.study.random:
            return self.study.random[path].mean()
        return self.study.fixed.get(path)


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A sweep: where it is kept, and its points."""

    title: str
    folder: Path
    keys: tuple[str, ...]
    points: Sequence[Point]


def plan_sweep(over: Sequence[str], folder: Path, load: Callable[[Sequence[str]], Study]) -> Sweep:
    """The points of a sweep; every study of it is validated before the first one runs.

    over : ``KEY=VALUE, VALUE, ...`` once or twice; load : gives the study with ``KEY=VALUE`` set

    Raises UsageError for keys or values that make no sweep, StudyError for a point whose study is
    invalid, FolderError for a folder that holds something else.
    """
    grid = _grid(over)
    combinations = list(itertools.product(*grid.values()))
    if len(combinations) > MOST_POINTS:
        raise UsageError(f"--over gives {len(combinations)} points; at most {MOST_POINTS}")
    points = []
    for texts in combinations:
        values = dict(zip(grid, texts, strict=True))
        study = load([f"{key}={text}" for key, text in values.items()])
        points.append(Point(values=values, study=study, name=_name(values)))
    names = [point.name for point in points]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise UsageError(f"--over: two points have the same folder name, {twice[0]}")
    if (folder / "results.json").exists():
        raise FolderError(f"{folder} holds a run; choose another directory with --out")
    return Sweep(title=points[0].study.title, folder=folder, keys=tuple(grid), points=points)


def _grid(over: Sequence[str]) -> dict[str, list[str]]:
    grid: dict[str, list[str]] = {}
    for text in over:
        key, sign, listed = (part.strip() for part in text.partition("="))
        values = [part.strip().strip("\"'") for part in listed.split(",")]
        if not sign or not key or "" in values:
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


def _name(values: Mapping[str, str]) -> str:
    """The name of a point's folder.

    >>> _name({"target.thickness": "10 mm", "impact.angle": "60 deg"})
    'thickness-10-mm_angle-60-deg'
    """
    parts = []
    for key, text in values.items():
        last = path_of(key).rpartition(".")[2]
        parts.append(re.sub(r"[^\w.+-]+", "-", f"{last} {text}").strip("-"))
    return "_".join(parts)


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


def write_sweep(sweep: Sweep, runs: Mapping[str, Run]) -> Path:
    """Write table and page of the points that have run; returns the page's place."""
    frame = sweep_table(sweep, runs)
    figure = svg(partial(_draw, sweep=sweep, frame=frame), 900.0, 380.0)
    first = next(iter(runs.values())).results
    chart = f"{capital(_free_name(first))} to use, and {chart_title(first).lower()} at the plan"
    html = render(
        "sweep.html",
        title=f"{sweep.title}: sweep",
        keys=[short(lookup(path_of(key)).meaning) for key in sweep.keys],
        done=len(runs),
        planned=len(sweep.points),
        picture=Picture(title=chart, text=f"{chart}: the numbers are in the table", svg=figure),
        decisions=_page_table(sweep, runs),
        points=[point.name for point in sweep.points if point.name in runs],
    )
    write_files(
        sweep.folder,
        {TABLE: frame.to_csv(index=False), "report.html": html, "figures/sweep.svg": figure},
    )
    return sweep.folder / "report.html"


def _free_name(results: Results) -> str:
    if results.study.free is None:
        return "number"
    return results.study.free.meaning


def sweep_table(sweep: Sweep, runs: Mapping[str, Run]) -> pd.DataFrame:
    """One row a point and decision, SI units.

    Columns: the keys as they were written, aim, use, use_low, use_high (the number to use, and the
    range of its best estimate), probability, low, high (of fracture, or of exceedance, at the
    plan), verdict, governing, runs, folder.
    """
    import pandas as pd

    rows: list[dict[str, Any]] = []
    for point in sweep.points:
        if point.name not in runs:
            continue
        results = runs[point.name].results
        for decision in results.decisions:
            p = _fracture(decision)
            use: dict[str, float | None] = dict.fromkeys(("use", "use_low", "use_high"))
            if decision.use is not None:
                best = decision.use.best
                use = {"use": decision.use.value, "use_low": best.low, "use_high": best.high}
            rows.append(
                {
                    **point.values,
                    **use,
                    "aim": decision.aim,
                    "probability": p.value,
                    "low": p.low,
                    "high": p.high,
                    "verdict": decision.verdict,
                    "governing": decision.governing,
                    "runs": results.accuracy.runs,
                    "folder": point.name,
                }
            )
    columns = ["aim", "use", "use_low", "use_high", "probability", "low", "high"]
    columns += ["verdict", "governing", "runs", "folder"]
    return pd.DataFrame(rows, columns=[*sweep.keys, *columns])


def _fracture(decision: Decision) -> Range:
    """Probability of the event at the plan, by all failure modes."""
    return as_event(decision, decision.all_modes or decision.probability)


def _page_table(sweep: Sweep, runs: Mapping[str, Run]) -> PageTable:
    rows = []
    for point in sweep.points:
        if point.name not in runs:
            continue
        results = runs[point.name].results
        for decision in results.decisions:
            text = decision_text(results, decision)
            rows.append(
                (
                    *point.values.values(),
                    text.use,
                    plain_probability(_fracture(decision)),
                    decision.verdict,
                    plain_name(decision.governing),
                )
            )
    name = exceedance_name(next(iter(runs.values())).results).lower()
    return PageTable(
        caption="Decisions",
        head=(*sweep.keys, "decision", f"{name} at the plan", "verdict", "governs"),
        rows=rows,
    )


def sweep_text(sweep: Sweep, runs: Mapping[str, Run], width: int) -> str:
    """The table of a sweep for a terminal."""
    shown = _page_table(sweep, runs)
    return "\n".join([sweep.title, "", *columns([shown.head, *shown.rows], width)])


def _draw(axes: Axes, sweep: Sweep, frame: pd.DataFrame) -> None:
    """The number to use, and the probability at the plan, over the first key."""
    figure = axes.figure
    axes.remove()
    left, right = figure.subplots(1, 2)
    free = sweep.points[0].study.margins
    name, unit, factor = "number", "", 1.0
    if free is not None:
        largest = float(frame["use"].astype(float).max())
        name = lookup(free.solve).meaning
        unit, factor = display_unit(free.solve, largest)
    left.set_ylabel(with_unit(f"{name} to use", unit))
    groups = dict.fromkeys(tuple(row) for row in frame[_series(sweep)].to_numpy().tolist())
    for k, group in enumerate(groups):
        chosen = frame[(frame[_series(sweep)] == list(group)).all(axis=1)]
        x = [_place(sweep, name) for name in chosen["folder"]]
        name = ", ".join(str(part) for part in group)
        colour = COLOURS[k % len(COLOURS)]
        use = chosen["use"].astype(float) * factor
        left.plot(x, use, "o-", color=colour, label=name)
        right.plot(x, 100.0 * chosen["probability"].astype(float), "o-", color=colour, label=name)
    for axis in (left, right):
        _key_axis(axis, sweep)
    right.set_ylabel("probability at the plan [%]")
    if len(groups) > 1:
        left.legend(fontsize="small")


def _series(sweep: Sweep) -> list[str]:
    """Columns that tell the curves of the chart apart."""
    limits = itertools.chain.from_iterable(point.study.limits for point in sweep.points)
    columns = list(sweep.keys[1:])
    if len({limit.aim for limit in limits}) > 1 or not columns:
        columns.append("aim")
    return columns


def _place(sweep: Sweep, name: str) -> float:
    """Where a point stands on the axis of the first key: at its value, or at its number."""
    key, points = sweep.keys[0], {point.name: point for point in sweep.points}
    number = points[name].number(key)
    if number is None:
        return float(_key_texts(sweep).index(points[name].values[key]))
    return number * display_unit(path_of(key))[1]


def _key_texts(sweep: Sweep) -> list[str]:
    """The values of the first key as they were written."""
    return list(dict.fromkeys(point.values[sweep.keys[0]] for point in sweep.points))


def _key_axis(axes: Axes, sweep: Sweep) -> None:
    key = sweep.keys[0]
    if sweep.points[0].number(key) is None:
        values = _key_texts(sweep)
        axes.set_xticks(np.arange(len(values)), values)
        axes.set_xlabel(key)
        return
    path = path_of(key)
    axes.set_xticks(sorted({_place(sweep, point.name) for point in sweep.points}))
    axes.set_xlabel(with_unit(short(lookup(path).meaning), display_unit(path)[0]))
