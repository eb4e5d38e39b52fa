"""The sampled points of a finished run, for figures and for the user's own analysis."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from uqsphere.errors import AccessError, FolderError, UsageError
from uqsphere.files import LARGEST_ARRAY, array_of, read_whole
from uqsphere.results.entries import SampleNames, read_entry
from uqsphere.runner.evaluate import Work
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.store import Store, read_json, write_atomically, write_json

if TYPE_CHECKING:
    import pandas as pd
    from xarray import Dataset

    from uqsphere.results.entries import Manifest
    from uqsphere.uq.surrogate import Surrogate

#: rows kept for figures: the first ones of every replicate
KEPT = 16_384


def save_points(work: Work, store: Store, sampled: Sampled) -> None:
    """Store the first rows of the sample: inputs, answers, status, censored flags."""
    sample = sampled.sample.head(max(1, KEPT // sampled.sample.replicates))
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
    names: dict[str, Any] = {"inputs": list(work.drawn.names), "quantities": list(work.quantities)}
    write_json(store.folder / "samples.json", names)


def read_points(folder: Path) -> tuple[list[str], list[str], npt.NDArray[np.float64]]:
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
    from uqsphere.uq.points import random_generator
    from uqsphere.uq.surrogate import fit_surrogate

    frame = load_samples(folder)
    known = [name.removeprefix("censored_") for name in frame.columns if name.startswith("censored_")]
    name = known[0] if output is None and known else str(output)
    if name not in known:
        raise UsageError(f"there is no quantity {name!r} (there are: {', '.join(known) or 'none'})")
    mark = read_json(folder / "study.resolved.json")
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
