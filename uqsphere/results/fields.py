"""What a run knows of answers that are vectors: fields.nc (NetCDF 3, any program reads it) and tables/fields.csv.

Variables of a field NAME, each over the dimension NAME_place but for its rows: NAME_place [s, or a number],
NAME_mean, NAME_quantile (level), NAME_first and NAME_total (input), each of these with _low and _high, the ends of
its 95 % interval, and NAME_row, the model's own answers (row).
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import FolderError
from uqsphere.files import read_whole
from uqsphere.store import csv_text, write_atomically
from uqsphere.uq.fields import Band, FieldAnswer

#: bytes of a file that is read: rows and intervals of a few fields of 10,000 places
_LARGEST: Final = 1 << 28
_BANDS: Final = ("mean", "quantiles", "first", "total")
_DIMENSIONS: Final = {"mean": (), "quantiles": ("level",), "first": ("input",), "total": ("input",)}


@dataclass(frozen=True, kw_only=True, eq=False)
class Stored:
    """An answer, its places (m,), and the inputs that it has indices of; none where these depend on each other."""

    answer: FieldAnswer
    places: Array
    inputs: tuple[str, ...]


def save_fields(folder: Path, found: Mapping[str, Stored]) -> None:
    """Write both files."""
    (folder / "tables").mkdir(exist_ok=True)
    write_atomically(folder / "fields.nc", as_netcdf(found))
    header = ("field", "place", "statistic", "of", "value", "low", "high")
    write_atomically(folder / "tables" / "fields.csv", csv_text(list(header), _rows(found)))


def _rows(found: Mapping[str, Stored]) -> list[tuple[str | float, ...]]:
    lines: list[tuple[str | float, ...]] = []
    for name, one in found.items():
        for kind in _BANDS:
            for of, value, low, high in _lines(one, kind):
                columns = (one.places.tolist(), value.tolist(), low.tolist(), high.tolist())
                lines += [(name, place, kind, of, *ends) for place, *ends in zip(*columns, strict=True)]
    return lines


def _lines(one: Stored, kind: str) -> list[tuple[str, Array, Array, Array]]:
    """What a band is of, and its three lines (m,) each."""
    band: Band = getattr(one.answer, kind)
    if kind == "mean":
        return [("", band.value, band.low, band.high)]
    names = [f"{level:g}" for level in one.answer.levels] if kind == "quantiles" else list(one.inputs)
    return [(of, band.value[k], band.low[k], band.high[k]) for k, of in enumerate(names)]


def as_netcdf(found: Mapping[str, Stored]) -> bytes:
    """The content of fields.nc."""
    from scipy.io import netcdf_file

    held = io.BytesIO()
    file: Any  # attributes of the file are set as those of the object
    with netcdf_file(held, "w") as file:
        one = next(iter(found.values()))
        file.fields, file.inputs = " ".join(found), " ".join(one.inputs)
        file.createDimension("level", len(one.answer.levels))
        file.createVariable("level", "f8", ("level",))[:] = one.answer.levels
        if one.inputs:
            file.createDimension("input", len(one.inputs))
        for name, stored in found.items():
            place, row, answer = f"{name}_place", f"{name}_row", stored.answer
            file.createDimension(place, len(stored.places))
            file.createDimension(row, len(answer.rows))
            file.createVariable(place, "f8", (place,))[:] = stored.places
            rows = file.createVariable(row, "f8", (row, place))
            rows[:] = answer.rows
            rows.components, rows.truncated, rows.error = answer.components, answer.truncated, answer.error
            for kind in _BANDS if stored.inputs else _BANDS[:2]:
                for end in fields(Band):
                    suffix = "" if end.name == "value" else f"_{end.name}"
                    variable = file.createVariable(f"{name}_{kind}{suffix}", "f8", (*_DIMENSIONS[kind], place))
                    variable[:] = getattr(getattr(answer, kind), end.name)
        file.flush()
        return held.getvalue()


def read_fields(folder: Path) -> dict[str, Stored]:
    """What fields.nc holds, but for aggregated indices, which results.json has; empty where there is none.

    Raises FolderError for a file that is not what a run writes.
    """
    path = folder / "fields.nc"
    if not path.is_file():
        return {}
    from scipy.io import netcdf_file

    file: Any
    try:
        with netcdf_file(io.BytesIO(read_whole(path, _LARGEST)), "r", mmap=False) as file:
            return {name: _read(file, name) for name in file.fields.decode().split()}
    except (ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError, MemoryError) as error:
        raise FolderError(f"{path} is not what a run writes") from error


def _read(file: Any, name: str) -> Stored:
    def numbers(variable: str) -> Array:
        return np.array(file.variables[variable][:], dtype=float)

    def band(kind: str) -> Band:
        if f"{name}_{kind}" not in file.variables:
            nothing = np.zeros((0, len(places)))
            return Band(value=nothing, low=nothing, high=nothing)
        return Band(value=numbers(f"{name}_{kind}"), low=numbers(f"{name}_{kind}_low"),
                    high=numbers(f"{name}_{kind}_high"))  # fmt: skip

    rows, places = file.variables[f"{name}_row"], numbers(f"{name}_place")
    answer = FieldAnswer(
        rows=numbers(f"{name}_row"), levels=tuple(numbers("level").tolist()),
        mean=band("mean"), quantiles=band("quantiles"), first=band("first"), total=band("total"),
        aggregated_first=[], aggregated_total=[], components=int(rows.components), truncated=float(rows.truncated),
        error=float(rows.error),
    )  # fmt: skip
    return Stored(answer=answer, places=places, inputs=tuple(file.inputs.decode().split()))
