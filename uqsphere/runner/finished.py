"""A finished run, as its folder has it."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

import uqsphere
from uqsphere.arrays import Array
from uqsphere.errors import AccessError, FolderError, UsageError
from uqsphere.files import LARGEST_ARRAY, array_of, load_document, read_whole, refuse_links
from uqsphere.quantities import display_unit, format_estimate, lookup
from uqsphere.results import NO_RIG, Results, read_results
from uqsphere.results.entries import Est, Manifest, SampleNames, read_entry, read_manifest
from uqsphere.results.tables import table_cells, tables
from uqsphere.store import Store, named_files, plain_cell, write_atomically, write_json, write_outputs, write_sums

if TYPE_CHECKING:
    from collections.abc import Iterable

    import pandas as pd
    from matplotlib.axes import Axes
    from xarray import Dataset

    from uqsphere.runner.evaluate import Work
    from uqsphere.uq import Sample
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
        asked = what if name is None else f"{what} {name!r}"
        raise UsageError(f"there is no {asked} (there are: {', '.join(names) or 'none'})")
    return names[0] if name is None else name


def _told(one: Est) -> str:
    """An estimate in words."""
    if one.value is None or one.low is None or one.high is None:
        return str(one.reason or "not known")
    return format_estimate(one.value, one.low, one.high, most=5)


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
        fields = self.results.analyses.get("fields")
        names = [*self.results.quantities, *(fields.values if fields else ())]
        return f"<Run{place}: {'; '.join(limits) or ', '.join(names)}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: title, and every limit with its probability of a miss and its verdict, else means."""
        from html import escape

        head: tuple[str, ...] = ("limit", "probability of a miss", "target", "verdict")
        answers: list[tuple[str, ...]] = [*self._answers()]
        if not answers:
            head = ("quantity", "mean")
            answers = [(name, _told(entry.mean)) for name, entry in self.results.quantities.items()]
        rows = "".join("<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in answers)
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
                told = _told(limit.miss)
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
        """A table of the run by its name in the folder tables/; raises FolderError where it is missing or damaged."""
        import pandas as pd

        path = self.folder / "tables" / f"{name}.csv"
        try:
            # a name may be NA or null: a cell that is empty, and no other, holds nothing
            return pd.read_csv(io.BytesIO(read_whole(path, LARGEST_ARRAY)), keep_default_na=False, na_values=[""])
        except AccessError as error:
            raise FolderError(f"{self.folder} has no tables/{path.name}: it is damaged; run the study again") from error
        except ValueError as error:
            raise FolderError(f"{path} is damaged: {error}") from error

    def quantities(self) -> pd.DataFrame:
        """Mean, standard deviation and quantiles of every quantity with their intervals."""
        return self.table("quantities")

    def samples(self) -> pd.DataFrame:
        """Rows that were sampled: inputs (SI), quantities (SI), `status`, censored flags `censored_NAME`."""
        import pandas as pd

        inputs, quantities, rows = read_points(self.folder)
        d, q = len(inputs), len(quantities)
        frame = pd.DataFrame(rows[:, : d + q], columns=[*inputs, *quantities])
        frame["status"] = rows[:, -1].astype(int)
        for k, name in enumerate(quantities):
            frame[f"censored_{name}"] = rows[:, d + q + k] > 0.0
        return frame

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
        from threadpoolctl import threadpool_limits

        from uqsphere.study import load_study
        from uqsphere.uq import random_generator
        from uqsphere.uq.surrogate import fit_surrogate

        frame = self.samples()
        known = [name.removeprefix("censored_") for name in frame.columns if name.startswith("censored_")]
        name = _chosen(output, known, "quantity")
        mark = load_document(self.folder / "study.resolved.json")
        overrides = tuple(mark.get("overrides", ())) if isinstance(mark, dict) else ()
        study = load_study(self.folder / "study.toml", overrides)
        if not study.random:
            raise UsageError("no input of the model is random: there is nothing to fit a surrogate over")
        good = frame[(frame["status"] == 0) & ~frame[f"censored_{name}"] & np.isfinite(frame[name])]
        chosen = random_generator(seed=study.seed, task=f"surrogate {name}").permutation(len(good))[:rows]
        inputs = study.inputs().only(tuple(study.random))
        with threadpool_limits(limits=1, user_api="blas"):
            x = good[list(inputs.names)].to_numpy()[chosen]
            return fit_surrogate(x, good[name].to_numpy()[chosen], inputs, output=name, plain=plain)

    def to_xarray(self) -> Dataset:
        """The stored rows as a Dataset of xarray, dimensions `chain` and `draw` as ArviZ has them, units as attributes.

        Raises UsageError where xarray is not installed.
        """
        try:
            import xarray
        except ImportError as error:
            raise UsageError('xarray is missing: pip install "uqsphere[xarray]"') from error

        frame, columns = self.samples(), {}
        for name in frame.columns:
            unit = "" if name == "status" or name.startswith("censored_") else lookup(name).unit
            columns[name] = (("chain", "draw"), frame[name].to_numpy()[None, :], {"units": unit} if unit else {})
        own = {"inference_library": "uqsphere", "inference_library_version": uqsphere.__version__}
        coordinates = {"chain": [0], "draw": np.arange(len(frame))}
        return xarray.Dataset(columns, coords=coordinates, attrs={"created_at": self.manifest.finished, **own})

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

    Raises FolderError when the folder is no result folder, or its run has not finished.
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


# --- samples -------------------------------------------------------------------------------------------------------


#: files of a folder beside its tables, where they are there
_FILES: Final = ("manifest.json", "results.json", "study.resolved.json", "study.toml", "samples.json", "samples.npy",
                 "courses.json", "sliders.json", "tables/courses.csv", "fields.nc", "tables/fields.csv")  # fmt: skip
#: rows kept for figures: the first ones of every replicate
KEPT = 16_384


def write_results(store: Store, results: Results, manifest: Manifest) -> None:
    """Tables, manifest.json and results.json, each written whole; results.json last, as the sign of the end."""
    found = tables(results)
    for name, text in found.items():
        write_atomically(store.folder / "tables" / name, text)
    write_json(store.folder / "manifest.json", manifest.document())
    write_json(store.folder / "results.json", results.document())
    data = named_files(read_whole(store.folder / "study.toml").decode("utf-8", "replace"))
    there = [name for name in (*_FILES, *data) if (store.folder / name).is_file()]
    write_sums(store.folder, [*(f"tables/{name}" for name in found), *there])


def save_points(work: Work, store: Store, sample: Sample) -> None:
    """Store the first rows of the sample: inputs, answers, status, censored flags."""
    sample = sample.head(max(1, KEPT // sample.replicates))
    d, q = len(work.drawn.names), len(work.quantities)
    parts = [
        sample.inputs.reshape(sample.size, d),
        sample.answers.reshape(sample.size, q),
        sample.censored.reshape(sample.size, q).astype(float),
        sample.status.reshape(sample.size, 1).astype(float),
    ]
    buffer = io.BytesIO()
    np.save(buffer, np.concatenate(parts, axis=1), allow_pickle=False)
    write_atomically(store.folder / "samples.npy", buffer.getvalue())
    names = SampleNames(inputs=tuple(work.drawn.names), quantities=work.quantities)
    write_json(store.folder / "samples.json", names.document())


def read_points(folder: Path) -> tuple[list[str], list[str], Array]:
    """Names of inputs and of quantities, and the rows: inputs, quantities, censored flags, status.

    Raises FolderError when they are missing or damaged.
    """
    names = read_entry(folder / "samples.json", SampleNames)
    inputs, quantities = list(names.inputs), list(names.quantities)
    try:
        rows = array_of(read_whole(folder / "samples.npy", LARGEST_ARRAY))
    except (AccessError, ValueError) as error:
        raise FolderError(f"the samples in {folder} are damaged: {error}") from error
    if rows.ndim != 2 or rows.shape[1] != len(inputs) + 2 * len(quantities) + 1:
        raise FolderError(f"the samples in {folder} are damaged: found an array of shape {rows.shape}")
    if not np.isfinite(rows[rows[:, -1] == 0.0]).all() or not np.isfinite(rows[:, -1]).all():
        raise FolderError(f"the samples in {folder} are damaged: a row without fault holds no numbers")
    return inputs, quantities, rows


# --- tables ----------------------------------------------------------------------------------------------


def _frames(run: Run) -> dict[str, pd.DataFrame]:
    """Samples, and the tables as results.json has them: what stands in tables/ may have been changed since."""
    import pandas as pd

    frames = {}
    for name, (header, rows) in sorted(table_cells(run.results).items()):
        if not (run.folder / "tables" / f"{name}.csv").is_file():
            raise FolderError(f"{run.folder} has no tables/{name}.csv: it is damaged; run the study again")
        cells = [[plain_cell(cell) or None if isinstance(cell, str) else cell for cell in row] for row in rows]
        frames[name] = pd.DataFrame(cells, columns=list(header))
    own = {} if run.results.rig == NO_RIG else {"samples": run.samples()}
    return {**own, **frames}


def _content(frame: pd.DataFrame, form: str) -> bytes:
    if form == "csv":
        return frame.rename(columns=plain_cell).to_csv(index=False).encode()
    if form == "json":
        return (json.dumps(json.loads(frame.to_json(orient="records", double_precision=15)), indent=1) + "\n").encode()
    buffer = io.BytesIO()
    try:
        frame.to_parquet(buffer, index=False)
    except ImportError as error:
        raise UsageError('parquet needs pyarrow: pip install "uqsphere[parquet]"') from error
    return buffer.getvalue()


def export_run(run: Run, form: str, folder: Path) -> list[Path]:
    """Write the samples and every table, those of services in folders of their names; the paths written.

    Raises UsageError for a format that is not known or whose package is missing.
    """
    if form not in ("csv", "json", "parquet"):
        raise UsageError(f"unknown format {form!r} (allowed: csv, json, parquet)")
    written = write_outputs(folder, {f"{name}.{form}": _content(frame, form) for name, frame in _frames(run).items()})
    for name, service in run.services.items():
        written += export_run(service, form, folder / "services" / name)
    return written
