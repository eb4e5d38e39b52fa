"""What both labs share: input files, units of keys, tables of the terminal, written files."""

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field

from uqsphere.documents import Fault, TomlTable, read_text, refusal, unknown
from uqsphere.errors import AccessError, StudyError, UsageError
from uqsphere.materials import materials_of
from uqsphere.tables import Table, read_table
from uqsphere.units import parse_value


def in_unit(dimension: str) -> BeforeValidator:
    """A key with a unit of a dimension."""
    return BeforeValidator(lambda text: parse_value(text, dimension))


#: a JSON document whose numbers are in SI units
JsonObject = dict[str, Any]
Positive = Annotated[float, Field(gt=0.0, strict=True)]
PoissonRatio = Annotated[float, Field(ge=0.0, lt=0.5), in_unit("number")]
Length = Annotated[Positive, in_unit("length")]
Pressure = Annotated[Positive, in_unit("pressure")]
Density = Annotated[Positive, in_unit("density")]
Force = Annotated[Positive, in_unit("force")]
Mass = Annotated[Positive, in_unit("mass")]
Speed = Annotated[Positive, in_unit("speed")]
Time = Annotated[float, in_unit("time")]


class Section(TomlTable):
    """A table of an input file."""

    model_config = ConfigDict(strict=False)


def from_library(raw: Any, *kinds: str) -> Any:
    """A table completed by E, nu and density of its `material`."""
    if not isinstance(raw, dict) or raw.get("material") is None:
        return raw
    materials = materials_of(*kinds)
    if str(raw["material"]) not in materials:
        raise Fault(unknown("material", raw["material"], materials), "material")
    properties = materials[raw["material"]].properties
    known = {key: properties[key].text for key in ("E", "nu", "density") if key in properties}
    return known | raw


class TableFile(Section):
    """A file with a table of numbers.

    sheet : of a workbook (default: the first with data).
    decimal : mark, if a column can be read both ways.
    """

    file: str = ""
    sheet: str = ""
    decimal: Literal[".", ","] | None = None

    def read(self, folder: Path, unit_keys: Mapping[str, str]) -> Table:
        """The table; raises as `uqsphere.tables.read_table`."""
        table = read_table(folder / self.file, decimal=self.decimal or "", sheet=self.sheet)
        return replace(table, unit_keys=unit_keys)


class InputError(UsageError):
    """An input file cannot be used: `faults` by their keys, from the top of the file."""

    def __init__(self, message: str, *at: str) -> None:
        super().__init__(message)
        self.faults = [Fault(message, *at)]


@contextmanager
def named_by(file: Path, *at: str) -> Iterator[None]:
    """What is wrong with what an input file gives stands there: at its key, at that of the column
    of a table of numbers, beside the last one of `at`, or else at that: a StudyError.  What cannot
    be read remains an AccessError.
    """
    try:
        yield
    except StudyError:
        raise
    except (UsageError, AccessError) as error:
        key = getattr(error, "key", "") or at[-1]
        faults = getattr(error, "faults", [Fault(str(error), *at[:-1], key)])
        told = refusal(file, read_text(file), faults)
        if isinstance(error, AccessError):
            raise AccessError(str(told)) from None
        raise told from None


def table(rows: Sequence[Sequence[str]]) -> str:
    """Texts in aligned columns, heads first."""
    from uqsphere.report.tables import columns

    return "\n".join(columns(rows))


def csv_text(content: Any, head: list[str] | None = None) -> str:
    """Columns by their names, or rows below a head, as CSV."""
    import pandas as pd

    return pd.DataFrame(content, columns=head).to_csv(
        index=False, float_format="%.9g", lineterminator="\n"
    )


def run_command(lab: str, *argv: str) -> int:
    """Run one of the `COMMANDS` of a lab, each with its help; `records` takes several files.

    Returns the exit code.
    """
    home = import_module(f"uqsphere.labs.{lab}.cli")
    parser = ArgumentParser(prog=f"uqsphere {lab}", description=home.__doc__)
    subparsers = parser.add_subparsers(dest="command", required=True)
    for name, (function, text) in home.COMMANDS.items():
        command = subparsers.add_parser(name, help=text, description=text)
        command.set_defaults(function=function)
        number = "+" if name == "records" else None
        command.add_argument("file", type=Path, nargs=number, help="input file (TOML)")
        command.add_argument("--out", type=Path, help="folder for the files")
        command.add_argument("--json", action="store_true", help="print one JSON document")
    chosen = parser.parse_args(argv)
    chosen.lab = lab
    return chosen.function(chosen) or 0


def finish(chosen: Namespace, content: JsonObject, text: str, files: Mapping[str, str]) -> None:
    """Write the files of a command to `--out`, and print its answer without control characters."""
    from uqsphere.results.folder import locked, owner_by_command, write_files

    file = chosen.file
    if isinstance(file, list):
        file = file[0]
    owner = owner_by_command(chosen.lab, file)
    written = []
    try:
        if chosen.out:
            with locked(chosen.out, owner):
                write_files(chosen.out, files, owner)
            written = [str(chosen.out / name) for name in files]
    finally:  # an answer is not lost with its files
        text = "\n".join([text, *(f"wrote {path}" for path in written)])
        if chosen.json:
            text = json.dumps({**content, "written": written}, indent=1, allow_nan=False)
        print("".join(mark if mark.isprintable() or mark == "\n" else "?" for mark in text))
