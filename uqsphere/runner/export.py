"""Samples and tables of a finished run in formats that other tools read."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import TYPE_CHECKING

from uqsphere.errors import AccessError, FolderError, UsageError
from uqsphere.files import LARGEST_ARRAY, read_whole
from uqsphere.results import NO_RIG
from uqsphere.results.tables import table_cells
from uqsphere.store import plain_cell, write_outputs

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
        frames[name] = pd.DataFrame([[_cell(value) for value in row] for row in rows], columns=list(header))
    own = {} if run.results.rig == NO_RIG else {"samples": run.samples()}
    return {**own, **frames}


def _cell(value: object) -> object:
    if isinstance(value, str):
        return plain_cell(value) or None
    return value


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
