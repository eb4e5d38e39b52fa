"""Samples and tables of a run: stored, read again, and in formats that other tools read."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import AccessError, FolderError, UsageError
from uqsphere.files import LARGEST_ARRAY, array_of, load_document, read_whole
from uqsphere.results import NO_RIG
from uqsphere.results.entries import SampleNames, read_entry
from uqsphere.results.tables import table_cells
from uqsphere.runner.evaluate import Work
from uqsphere.store import Store, plain_cell, write_atomically, write_json, write_outputs
from uqsphere.uq import Sample

if TYPE_CHECKING:
    import pandas as pd
    from xarray import Dataset

    from uqsphere.results import Manifest
    from uqsphere.runner.finished import Run
    from uqsphere.uq.surrogate import Surrogate

#: rows kept for figures: the first ones of every replicate
KEPT = 16_384


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

    Raises
    ------
    FolderError
        When they are missing or damaged.
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


def load_samples(folder: Path) -> pd.DataFrame:
    """The stored rows as a table: a column per input and quantity (SI), `status`, `censored_NAME`."""
    import pandas as pd

    inputs, quantities, rows = read_points(folder)
    d, q = len(inputs), len(quantities)
    frame = pd.DataFrame(rows[:, : d + q], columns=[*inputs, *quantities])
    frame["status"] = rows[:, -1].astype(int)
    for k, name in enumerate(quantities):
        frame[f"censored_{name}"] = rows[:, d + q + k] > 0.0
    return frame


def surrogate_of(folder: Path, output: str | None, *, rows: int, plain: bool) -> Surrogate:
    """A surrogate of a quantity, fitted to stored rows that have an answer; `Run.surrogate`."""
    from threadpoolctl import threadpool_limits

    from uqsphere.study import load_study
    from uqsphere.uq import random_generator
    from uqsphere.uq.surrogate import fit_surrogate

    frame = load_samples(folder)
    known = [name.removeprefix("censored_") for name in frame.columns if name.startswith("censored_")]
    name = known[0] if output is None and known else str(output)
    if name not in known:
        raise UsageError(f"there is no quantity {name!r} (there are: {', '.join(known) or 'none'})")
    mark = load_document(folder / "study.resolved.json")
    study = load_study(folder / "study.toml", tuple(mark.get("overrides", ())) if isinstance(mark, dict) else ())
    if not study.random:
        raise UsageError("no input of the model is random: there is nothing to fit a surrogate over")
    good = frame[(frame["status"] == 0) & ~frame[f"censored_{name}"] & np.isfinite(frame[name])]
    chosen = random_generator(seed=study.seed, task=f"surrogate {name}").permutation(len(good))[:rows]
    inputs = study.inputs().only(tuple(study.random))
    with threadpool_limits(limits=1, user_api="blas"):
        x = good[list(inputs.names)].to_numpy()[chosen]
        return fit_surrogate(x, good[name].to_numpy()[chosen], inputs, output=name, plain=plain)


def dataset_of(frame: pd.DataFrame, manifest: Manifest) -> Dataset:
    """Stored rows as xarray has them; `Run.to_xarray`."""
    try:
        import xarray
    except ImportError as error:
        raise UsageError('xarray is missing: pip install "uqsphere[xarray]"') from error
    import uqsphere
    from uqsphere.quantities import lookup

    columns = {}
    for name in frame.columns:
        unit = "" if name == "status" or name.startswith("censored_") else lookup(name).unit
        columns[name] = (("chain", "draw"), frame[name].to_numpy()[None, :], {"units": unit} if unit else {})
    own = {"inference_library": "uqsphere", "inference_library_version": uqsphere.__version__}
    coordinates = {"chain": [0], "draw": np.arange(len(frame))}
    return xarray.Dataset(columns, coords=coordinates, attrs={"created_at": manifest.finished, **own})


# --- tables ----------------------------------------------------------------------------------------------


def read_table(folder: Path, name: str) -> pd.DataFrame:
    """A table of a finished run.

    Raises
    ------
    FolderError
        When it is missing or damaged.
    """
    import pandas as pd

    path = folder / "tables" / f"{name}.csv"
    try:
        # a name may be NA or null: a cell that is empty, and no other, holds nothing
        return pd.read_csv(io.BytesIO(read_whole(path, LARGEST_ARRAY)), keep_default_na=False, na_values=[""])
    except AccessError as error:
        raise FolderError(f"{folder} has no tables/{path.name}: it is damaged; run the study again") from error
    except ValueError as error:
        raise FolderError(f"{path} is damaged: {error}") from error


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

    Raises
    ------
    UsageError
        For a format that is not known or whose package is missing.
    """
    if form not in ("csv", "json", "parquet"):
        raise UsageError(f"unknown format {form!r} (allowed: csv, json, parquet)")
    written = write_outputs(folder, {f"{name}.{form}": _content(frame, form) for name, frame in _frames(run).items()})
    for name, service in run.services.items():
        written += export_run(service, form, folder / "services" / name)
    return written
