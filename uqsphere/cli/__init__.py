"""The command line: all commands and their arguments as one table, and one of them run; nothing heavy is imported."""

from __future__ import annotations

import argparse
import atexit
import contextlib
import gc
import os
import shlex
import signal
import sys
import threading
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Final, NamedTuple, NoReturn

import uqsphere
from uqsphere.console import outlets, plain_lines
from uqsphere.errors import AccessError, UqsphereError, UsageError

_EPILOG: Final = """exit codes: 0 ok, 1 internal error, 2 invalid study or usage, 3 a target was not met, 4 too many
failed evaluations, 5 result folder locked, foreign or damaged, 6 input/output, 130 or 143 interrupted"""


class Argument(NamedTuple):
    """An argument as `argparse` takes it; of those with the same `group` in a command one may be given."""

    flags: tuple[str, ...]
    options: dict[str, object]
    group: str = ""


class Command(NamedTuple):
    """A command: what it does, the module that does it in its function `command_NAME`, and its arguments."""

    text: str
    module: str
    arguments: tuple[Argument, ...]


def _flag(name: str, text: str, group: str = "") -> Argument:
    return Argument((name,), {"action": "store_true", "help": text}, group)


def _word(name: str, metavar: str | None, text: str | None = None, **more: object) -> Argument:
    """An argument with a value: a text unless `type` says otherwise."""
    return Argument((name,), {"metavar": metavar, "help": text, **more})


def _path(name: str, metavar: str, text: str | None = None, **more: object) -> Argument:
    return _word(name, metavar, text, type=Path, **more)


_JSON: Final = _flag("--json", "print one JSON document on stdout")
_SET: Final = _word("--set", "PATH=VALUE", 'replace a value of the study, such as striker.speed.mean="0.6 m/s"; '
                    "margins=null takes it out", dest="overrides", action="append", default=[])  # fmt: skip
_STUDY: Final = (_path("study", "FILE"), _SET)
_FOLDER: Final = _path("folder", "DIR")
_MODEL: Final = "FILE.py:FUNCTION"

COMMANDS: Final = {
    # --- that begin with a study
    "new": Command("write a commented study to start from", "studies", (
        _word("template", "TEMPLATE", "a name of `uqsphere list templates` (default: granite)", nargs="?",
              default="granite"),
        Argument(("-o", "--output"), {"metavar": "FILE", "type": Path, "help": "default: TEMPLATE.toml"}),
    )),
    "check": Command("validate a study; print the resolved scene and what a run will cost", "studies", _STUDY),
    "run": Command("run a study and write its report", "run", (
        *_STUDY,
        _path("--out", "DIR", "result folder (default: the study's name + -results)"),
        Argument(("-j", "--jobs"), {"type": int, "metavar": "N", "help": "processors to use (default: all)"}),
        _word("--budget", "TIME", 'time budget in place of the study\'s, such as "10min"'),
        _flag("--resume", "go on with what is stored (the default)", "again"),
        _flag("--fresh", "drop what is stored and begin again", "again"),
        _flag("--extend", "let a study that asks more of the same inputs go on with what DIR holds", "again"),
        _word("--dask", "ADDRESS", 'evaluate on a Dask cluster: "tcp://HOST:8786" of its scheduler, or "local" for one '
              "of this machine's processes (-j of them)"),
        _word("--model", _MODEL, "the model of a black-box study, or FILE.toml that names a program; THIS RUNS IT"),
    )),
    "history": Command("one deterministic scene over time, all numbers at their means", "studies", (
        *_STUDY, _path("--out", "DIR", "write history.csv and the figures here"),
    )),
    # --- that look at the folder of a run
    "report": Command("build the report again from what is stored", "run", (
        _FOLDER,
        _flag("--pdf", "also as report.pdf (needs the extra: uqsphere[pdf])"),
        _flag("--brief", "the one sheet alone, as brief.html (with --pdf as brief.pdf)"),
        _flag("--full", "with --pdf: methods, tables and words in print too"),
    )),
    "show": Command("the answers of a run as a table", "run", (_FOLDER,)),
    "export": Command("samples and tables of a run in another format", "run", (
        _FOLDER,
        _word("--format", None, required=True, choices=("csv", "parquet", "json")),
        _path("--out", "DIR", "where to write (default: DIR/export)"),
    )),
    "verify": Command("checksums of everything stored, and some of it evaluated again", "run", (
        _FOLDER,
        _word("--chunks", "N", "chunks to evaluate again (default 3)", type=int, default=3),
        _word("--seed", None, "which of them (default 0)", type=int, default=0),
        _word("--model", _MODEL, "the model of a black box; THIS RUNS THE FILE"),
    )),
    "compare": Command("two runs side by side: what changed, by how much, and whether that is significant", "run", (
        _path("before", "DIR"), _path("after", "DIR"), _path("--out", "FILE.html", "write a page with figures"),
    )),
    # --- that begin with data, or with the design of a test
    "analyse": Command("laws, dependence and drivers from a table of runs that were made already", "data", (
        _path("data", "DATA.csv"),
        _word("--inputs", "A,B", "columns that went in, divided by commas", required=True),
        _word("--outputs", "Y,Z", "columns that came out", required=True),
        _path("--laws", "STUDY.toml", "the laws that the runs were drawn from, if known"),
        _path("--out", "DIR", "write analysis.json and inputs.toml here"),
    )),
    "records": Command("pulse, contact forces and stiffness from records of strain gauges", "records", (
        _path("record", "FILE", "time and one signal, two gauges or three waves, or two gauges a bar; or a folder of "
              "such files"),
        _path("--study", "STUDY", "sphere and bars; needed for forces"),
        _SET,
        _word("--columns", "T,A,B", "columns that count, by name or number: time, then signals; gauges of a bar as "
              "A+B"),
        _path("--with", "FILE", "further channels of the same shot, in a file of their own", dest="beside",
              action="append", default=[]),
        _word("--unit", None, "unit of the signals, such as microstrain or mV", default=""),
        _word("--time-unit", None, "unit of the time, such as us", default=""),
        _word("--sample-interval", "TIME", "for a file without a time", default=""),
        _word("--gauge-factor", "K[,K]", "one, or one for each bar", default="2"),
        _word("--excitation", "V[,V]", "supply of the bridge, volts", default="0"),
        _word("--amplification", "A[,A]", default="1"),
        _word("--active-arms", "N[,N]", "1 quarter, 2 half bridge", default="1"),
        _word("--incident-gauge", "LENGTH", "its distance from the sphere", default="0 m"),
        _word("--receiving-gauge", "LENGTH", "its distance from the sphere", default="0 m"),
        _word("--window", "BEGIN,END", 'times of the incident wave, such as "100 us,420 us"'),
        _word("--polarity", None, "what is positive in the record (default: the first wave presses)",
              choices=("auto", "tension", "compression"), default="auto"),
        _flag("--correct-dispersion", "carry the waves from gauges to faces"),
        _word("--receiving-bar", "KEYS", 'where it is another: "E=72 GPa, density=2810 kg/m3"'),
        _word("--specimen", None, "other: forces and energies alone, no elastic sphere is fitted",
              choices=("sphere", "other"), default="sphere"),
        _word("--bound", "FORCE", "more than such a specimen can bear is doubted", default=""),
        _path("--calibration", "FILE", "a shot without a specimen, wired alike: it gives bar speed and gains"),
        _word("--striker-speed", "SPEED", "of the calibration shot", default=""),
        _flag("--pdf", "the sheet on paper too, with --out"),
        _word("--gain-sd", "SD", "of each gauge, relative (default 0.01)", type=float, default=0.01),
        _path("--out", "DIR", "write tables and figures here"),
    )),
    "fit-contact": Command("onset, hardness and pile-up from a slow test on a sphere between two platens", "records", (
        _path("record", "FILE.csv", "displacement and force, loaded and let go"),
        _word("--diameter", "LENGTH", 'of the sphere, such as "20 mm"', required=True),
        _word("--platens", "NAME", "a material of bars or plates, or rigid; E of the sphere follows", default="rigid"),
        _word("--nu", None, "Poisson ratio of the sphere (default 0.25)", type=float, default=0.25),
        _word("--columns", "D,F", "columns that count: displacement, force"),
        _word("--displacement-unit", "UNIT", "such as um", default=""),
        _word("--force-unit", "UNIT", "such as kN", default=""),
        _word("--machine-stiffness", "K", 'such as "100 kN/mm" (default: rigid)'),
        _word("--pile-up", "C", "where it is known, 1 to 3: it is not fitted then", type=float),
    )),
    "fit": Command("the law of fracture energy that tests of single particles leave open", "feed", (
        _path("study", "FILE", "with a table [tests]"), _SET,
        _path("--out", "DIR", "where to write (default: the study's name + -fit)"),
    )),
    "plan-tests": Command("how many more tests of single particles, and which tells most", "feed", (
        *_STUDY,
        _word("--precision", "X", "95 %% half-width that is wanted: of an energy relative, of a share as it is "
              "(default 0.2)", type=float, default=0.2),
        _word("--at", "SIZE", 'aim at the energy that breaks half at this size, such as "20 mm" (default: the share '
              "broken of [feed], else the largest tested size)"),
    )),
    "feed": Command("what becomes of a feed under its blows, from tests of its particles", "feed", (
        *_STUDY,
        _path("--fit", "DIR", "a posterior of `uqsphere fit`, in place of [tests]"),
        _path("--out", "DIR", "where to write (default: the study's name + -feed)"),
    )),
    "export-dem": Command("draws of a feed's parameters for a DEM program, as it names them", "feed", (
        _path("folder", "DIR", "what `uqsphere feed` wrote"),
        _word("--to", None, required=True, choices=("rocky", "liggghts", "edem", "csv")),
        _word("--draws", "N", "spread over the share broken (default 20)", type=int, default=20),
        _word("--rig-factor", "X", "E_inf is multiplied by it: 1 + k_p/k_s of the test rig, where the program divides "
              "(default: not)", type=float),
        _path("--out", "DIR", "where to write (default: DIR/dem)"),
    )),
    "plan": Command("what breaks a sphere as wanted: speeds, ramps and lengths between bars, the one number of another "
                    "rig", "plan", (
        *_STUDY,
        _word("--speed", "LOW,HIGH", "striker speeds, m/s unless a unit stands there (default: those of the margins, "
              "or a decade about the study's)"),
        _word("--rise", "LOW,HIGH", "ramps of the pulse, us unless a unit stands there (default: 0 up to the length of "
              "the pulse)"),
        _word("--length", "L[,L]", "striker lengths, m unless a unit stands there (default: the study's)"),
        _word("--imbalance", "X", "largest |P_A - P_B| at fracture over the larger force (default 0.1)", type=float,
              default=0.1),
        _word("--quantile", "P", "the specimen that is shown: quantile of the strength (default 0.5)", type=float,
              default=0.5),
        _word("--grid", "NxM", "speeds and ramps of the map (default 60x41)", default="60x41"),
        _path("--out", "DIR", "write plan.csv, windows.csv and the figure here"),
    )),
    # --- what there is, and this installation
    "list": Command("what there is to choose from", "data", (
        _word("what", None, choices=("materials", "models", "quantities", "criteria", "templates")),
    )),
    "bench": Command("speed against error on this machine", "data", (
        _flag("--quick", "fewer of everything: a minute instead of ten or more"),
        _flag("--measured", "the model beside published measurements instead"),
        _path("--out", "DIR", "where to write (default: bench-results)"),
    )),
    "serve": Command("the impact model of a study as an UM-Bridge server on this machine", "studies", (
        *_STUDY, _word("--port", None, "where it listens (default: 4242)", type=int, default=4242),
    )),
    "schema": Command("print the JSON schema of study files, for editors", "studies", ()),
    "doctor": Command("check this installation", "data", ()),
}  # fmt: skip


class _Parser(argparse.ArgumentParser):
    """argparse with the family's exit code and a pointer to the help."""

    def error(self, message: str) -> None:  # type: ignore[override]
        raise UsageError(f"{message} (see {self.prog} --help)")


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    parser = _Parser(
        prog="uqsphere",
        description="Fracture risk of brittle spheres between split Hopkinson bars, with its uncertainty.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"uqsphere {uqsphere.__version__}")
    made = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_Parser)
    for name, command in COMMANDS.items():
        own = made.add_parser(name, help=command.text, description=command.text)
        own.set_defaults(module=f"uqsphere.cli.{command.module}")
        groups: dict[str, argparse._MutuallyExclusiveGroup] = {}
        for flags, options, group in (*command.arguments, _JSON):
            if group and group not in groups:
                groups[group] = own.add_mutually_exclusive_group()
            (groups[group] if group else own).add_argument(*flags, **options)  # type: ignore[arg-type]
    return parser


# --- one command, its errors and its exit code --------------------------------------------------------------


#: exit codes beside those of the error family
INTERRUPTED, TERMINATED = 130, 143

# no plugin of pydantic's concerns a study, and looking for them reads every installed package's metadata
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")


class _Terminated(BaseException):
    """The system asks this process to end (SIGTERM)."""


def _terminate(number: int, frame: FrameType | None) -> None:
    raise _Terminated


def _go_on(chosen: argparse.Namespace | None, arguments: Sequence[str]) -> str:
    """How to go on after an interruption; the command that does it never drops what is stored."""
    if chosen is None or chosen.command != "run":
        return "interrupted"
    again = [word for word in arguments if not (chosen.fresh and word.startswith("--f"))]
    return f"interrupted; what was evaluated is kept, and this goes on with it:\n  uqsphere {shlex.join(again)}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit code.  Errors of the family are printed, never raised."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    handler = None
    if threading.current_thread() is threading.main_thread():
        handler = signal.signal(signal.SIGTERM, _terminate)
    try:
        with outlets():
            return _carry_out(given)
    finally:
        if handler is not None:
            signal.signal(signal.SIGTERM, handler)


def program() -> NoReturn:
    """`main` as a program: at its end the process goes at once, as taking compiled code apart takes half a second."""
    code = UqsphereError.exit_code

    def leave() -> None:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError, AttributeError):
                stream.flush()
        os._exit(code)

    atexit.register(leave)  # the first to be registered is the last to be called
    # what imports and results hold is never garbage: looking through it at Python's own thresholds takes 0.6 of 9 s
    gc.set_threshold(100_000, 50, 100)
    # threads of linear algebra that wait for work in a loop keep the other processes of a run from a processor
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")
    try:
        code = main()
    except SystemExit as asked:
        code = int(asked.code or 0)
    sys.exit(code)


def _carry_out(given: Sequence[str]) -> int:
    """One command; the exit code."""
    chosen: argparse.Namespace | None = None
    try:
        chosen = build_parser().parse_args(given)
        does = getattr(import_module(chosen.module), f"command_{chosen.command.replace('-', '_')}")
        code = int(does(chosen))
        sys.stdout.flush()
        return code
    except UqsphereError as error:
        text = plain_lines(str(error))
        print(f"uqsphere: {text}" if not hasattr(error, "problems") else text, file=sys.stderr)
        return error.exit_code
    except (KeyboardInterrupt, _Terminated) as error:
        print(f"\nuqsphere: {_go_on(chosen, given)}", file=sys.stderr)
        return TERMINATED if isinstance(error, _Terminated) else INTERRUPTED
    except Exception as error:
        return _unforeseen(error)


def _unforeseen(error: Exception) -> int:
    """Tell of an error that is none of the family; the exit code."""
    if os.environ.get("UQSPHERE_DEBUG"):
        raise error
    if isinstance(error, OSError):
        print(f"uqsphere: {error.filename or 'input/output'}: {error.strerror or error}", file=sys.stderr)
        return AccessError.exit_code
    if isinstance(error, MemoryError):
        print("uqsphere: out of memory: lower analysis.budget.evaluations, or use a larger machine", file=sys.stderr)
    else:
        print(
            f"uqsphere: internal error: {type(error).__name__}: {error}\n"
            "  this is a fault of uqsphere; set UQSPHERE_DEBUG=1 to see where it happened",
            file=sys.stderr,
        )
    return UqsphereError.exit_code
