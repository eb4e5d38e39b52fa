"""A finished run, as its folder has it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.errors import FolderError, UsageError
from uqsphere.files import load_document, refuse_links
from uqsphere.quantities import display_unit, format_estimate
from uqsphere.results import Results, read_results
from uqsphere.results.entries import Manifest, read_manifest

if TYPE_CHECKING:
    from collections.abc import Iterable

    import pandas as pd
    from matplotlib.axes import Axes
    from xarray import Dataset

    from uqsphere.uq.surrogate import Surrogate

#: bars of a histogram
_BINS = 60


@dataclass(frozen=True, kw_only=True)
class Plots:
    """What can be drawn of a run.  Every figure takes the axes that it is drawn into, or makes some, and returns them.

    Raises UsageError for a name that the run does not have.
    """

    run: Run

    def fragility(self, limit: str | None = None, ax: Axes | None = None) -> Axes:
        """Probability that a limit is exceeded over the free scalar, with its band, and the values solved for."""
        margins = self.run.results.margins
        name = _chosen(limit, margins, "limit with margins")
        entry, axes = margins[name], _axes(ax)
        quantity = entry.solve
        unit, factor = display_unit(quantity)
        curve = np.array([[p.value, p.probability, p.low, p.high] for p in entry.curve])
        (line,) = axes.plot(factor * curve[:, 0], curve[:, 1], label=name)
        axes.fill_between(factor * curve[:, 0], curve[:, 2], curve[:, 3], color=line.get_color(), alpha=0.25)
        solved = [(factor * e.value, float(p)) for p, e in entry.values.items() if e.value is not None]
        if solved:
            axes.plot(*zip(*solved, strict=True), "o", color=line.get_color())
        if curve[0, 0] > 0.0:
            axes.set_xscale("log")
        axes.set(xlabel=f"{quantity} [{unit}]", ylabel=f"probability of exceeding {name}", ylim=(0.0, 1.0))
        return axes

    def indices(self, quantity: str | None = None, ax: Axes | None = None) -> Axes:
        """Shares of the variance of a quantity: total indices, Shapley effects where inputs depend on each other."""
        found = self.run.results.sensitivity
        name = _chosen(quantity, found, "quantity with indices")
        entry, axes = found[name], _axes(ax)
        order = entry.shapley or entry.total
        known = sorted(((e.value, e.low, e.high, n) for n, e in order.items() if e.value is not None), reverse=True)
        values = np.array([value for value, *_ in known])
        ends = np.array([[value - (low or 0.0), (high or 1.0) - value] for value, low, high, _ in known]).T
        axes.barh([n for *_, n in known], values, xerr=np.maximum(ends, 0.0) if known else None)
        axes.set(xlabel=f"{'Shapley effect' if entry.shapley else 'total index'} of {name}", xlim=(0.0, 1.0))
        return axes

    def histogram(self, quantity: str | None = None, ax: Axes | None = None) -> Axes:
        """How a quantity is distributed over the stored rows that have an answer."""
        samples, axes = self.run.samples(), _axes(ax)
        name = _chosen(quantity, self.run.results.quantities, "quantity")
        unit, factor = display_unit(name)
        axes.hist(factor * samples.loc[samples["status"] == 0, name], bins=_BINS, density=True)
        axes.set(xlabel=f"{name} [{unit}]" if unit else name, ylabel="density")
        return axes


def _axes(given: Axes | None) -> Axes:
    """The axes given, or new ones of a figure by themselves."""
    if given is not None:
        return given
    from matplotlib import pyplot

    return pyplot.subplots()[1]


def _chosen(name: str | None, known: Iterable[str], what: str) -> str:
    """A name that the run has; the first where none is given."""
    names = list(known)
    if not names or (name is not None and name not in names):
        raise UsageError(
            f"there is no {what} {'' if name is None else repr(name)} (there are: {', '.join(names) or 'none'})"
        )
    return names[0] if name is None else name


# --- figures of a run ----------------------------------------------------------------------------------------------


class Keeper:
    """A private folder that lasts as long as this does."""

    def __init__(self) -> None:
        import shutil
        import tempfile
        import weakref

        self.folder = Path(tempfile.mkdtemp(prefix="uqsphere-"))
        weakref.finalize(self, shutil.rmtree, self.folder, ignore_errors=True)


@dataclass(frozen=True, kw_only=True)
class Run:
    """A finished run: its folder, the content of results.json and of manifest.json.

    `keeper` is there where no folder was asked for: the one that it has goes when the run does.
    """

    folder: Path
    results: Results
    manifest: Manifest
    keeper: Keeper | None = field(default=None, repr=False, compare=False)

    def __repr__(self) -> str:
        limits = [f"{row[0]} {row[1]} {row[3]}".rstrip() for row in self._answers()]
        place = "" if self.keeper else f" in {str(self.folder)!r}"
        return f"<Run{place}: {'; '.join(limits) or ', '.join(self.results.quantities)}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: title, and every limit with its probability of a miss and its verdict."""
        from html import escape

        head = ("limit", "probability of a miss", "target", "verdict")
        rows = "".join("<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in self._answers())
        titles = "".join(f"<th>{name}</th>" for name in head)
        return (
            f"<table><caption>{escape(self.results.study.title)}</caption>"
            f"<thead><tr>{titles}</tr></thead><tbody>{rows}</tbody></table>"
        )

    def _answers(self) -> list[tuple[str, str, str, str]]:
        """Limit, probability of a miss with its interval, target and verdict, services by their names."""
        rows = []
        for service, part in self.results.parts.items():
            for name, limit in part.limits.items():
                miss = limit.miss
                told = str(miss.reason or "not known")
                if miss.value is not None and miss.low is not None and miss.high is not None:
                    told = format_estimate(miss.value, miss.low, miss.high, most=5)
                called = f"{service}: {name}" if service else name
                target = "" if limit.target is None else f"{limit.target:g}"
                rows.append((called, told, target, "" if limit.target is None else limit.word))
        return rows

    @property
    def plot(self) -> Plots:
        """Figures of the run, each drawn into axes of matplotlib: `run.plot.fragility()`."""
        return Plots(run=self)

    @property
    def met(self) -> bool:
        """Whether the verdict on every limit with a target is that it is met, of services too."""
        limits = [limit for part in self.results.parts.values() for limit in part.limits.values()]
        return all(limit.verdict == "met" for limit in limits if limit.target is not None)

    @property
    def services(self) -> dict[str, Run]:
        """The runs of the study's services, as their own folders have them."""
        runs = {name: open_run(self.folder / "services" / name) for name in self.results.services}
        return {name: replace(run, keeper=self.keeper) for name, run in runs.items()}

    def table(self, name: str) -> pd.DataFrame:
        """A table of the run by its name in the folder tables/; raises FolderError where there is none."""
        from uqsphere.runner.export import read_table

        return read_table(self.folder, name)

    def quantities(self) -> pd.DataFrame:
        """Mean, standard deviation and quantiles of every quantity with their intervals."""
        return self.table("quantities")

    def samples(self) -> pd.DataFrame:
        """Rows that were sampled: inputs (SI), quantities (SI), status, censored flags."""
        from uqsphere.runner.export import load_samples

        return load_samples(self.folder)

    def surrogate(self, output: str | None = None, *, rows: int = 2048, plain: bool = False) -> Surrogate:
        """A surrogate of a quantity, fitted to rows of the run: `predict(rows) -> value, low, high`.

        Parameters
        ----------
        output : name of the quantity; the first if None
        rows : the most rows that it is fitted to; a tenth of the time at a tenth of them
        plain : expand the quantity itself, in one piece: what `Surrogate.to_chaospy` takes

        Raises
        ------
        UsageError
            For a name that the run does not have, and where the rows are too few.
        """
        from uqsphere.runner.export import surrogate_of

        return surrogate_of(self.folder, output, rows=rows, plain=plain)

    def to_xarray(self) -> Dataset:
        """The stored rows as a Dataset of xarray, dimensions `chain` and `draw` as ArviZ has them, units as attributes.

        Raises UsageError where xarray is not installed.
        """
        from uqsphere.runner.export import dataset_of

        return dataset_of(self.samples(), self.manifest)

    def indices(self) -> pd.DataFrame:
        """First and total Sobol' indices with their intervals."""
        return self.table("sensitivity")

    def limits(self) -> pd.DataFrame:
        """Probabilities and margins of every limit with their intervals."""
        return self.table("limits")

    def margins(self) -> pd.DataFrame:
        """Values of the free scalar at the probabilities asked for."""
        return self.table("margins")


def open_run(folder: str | Path) -> Run:
    """A finished run from its folder.

    Raises
    ------
    FolderError
        When the folder is no result folder, or its run has not finished.
    """
    path = Path(folder)
    if not path.is_dir():
        raise FolderError(f"{path} is not a result folder")
    refuse_links(path)
    if not (path / "results.json").is_file() and (path / "study.resolved.json").is_file():
        raise FolderError(f"the run in {path} has not finished: run the study again to go on with it")
    results = read_results(path)
    mark = load_document(path / "study.resolved.json") if (path / "study.resolved.json").is_file() else {}
    if isinstance(mark, dict) and mark.get("hash", results.study.hash) != results.study.hash:
        raise FolderError(f"the run in {path} that extends another has not finished: run the study again")
    return Run(folder=path, results=results, manifest=read_manifest(path))
