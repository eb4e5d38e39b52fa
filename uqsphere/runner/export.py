"""Samples and tables of a finished run in formats that other tools read."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import TYPE_CHECKING

from uqsphere.errors import FolderError, UsageError
from uqsphere.results import NO_RIG
from uqsphere.results.tables import tables
from uqsphere.store import plain_cell, write_atomically

if TYPE_CHECKING:
    import pandas as pd

    from uqsphere.runner.finished import Run


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
        return pd.read_csv(path)
    except FileNotFoundError as error:
        raise FolderError(f"{folder} has no tables/{path.name}: it is damaged; run the study again") from error
    except (OSError, ValueError) as error:
        raise FolderError(f"{path} is damaged: {error}") from error


def _frames(run: Run) -> dict[str, pd.DataFrame]:
    """Samples, and the tables as results.json has them: what stands in tables/ may have been changed since."""
    import pandas as pd

    found = sorted(tables(run.results).items())
    for name, _ in found:
        if not (run.folder / "tables" / name).is_file():
            raise FolderError(f"{run.folder} has no tables/{name}: it is damaged; run the study again")
    frames = {name.removesuffix(".csv"): pd.read_csv(io.StringIO(text)) for name, text in found}
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
    written = []
    for name, frame in _frames(run).items():
        path = folder / f"{name}.{form}"
        write_atomically(path, _content(frame, form))
        written.append(path)
    for name, service in run.services.items():
        written += export_run(service, form, folder / "services" / name)
    return written
