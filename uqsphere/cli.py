"""The command line: one function a command.  Only the answer goes to stdout; progress and notes go
to stderr.
"""

import contextlib
import gc
import io
import json
import os
import signal
import sys
import warnings
from argparse import ArgumentParser, ArgumentTypeError, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from inspect import getdoc
from itertools import chain
from pathlib import Path
from threading import Event
from typing import Any, NoReturn

from uqsphere.errors import FolderError, UqsphereError, UsageError, tell
from uqsphere.files import packaged

#: exit codes beside those of errors: a decision that is not "met", and an interruption
NOT_MET, INTERRUPTED = 3, 130
#: every exit code, as `uqsphere --help` lists them
EXIT_CODES = {
    0: "done; with a target: every decision is met",
    1: "internal error",
    2: "invalid study, input file or command",
    3: "done, but a decision with a target is not met, undecided or not established",
    4: "the model failed in too many runs",
    5: "results directory in use, damaged, or of another study",
    6: "a file could not be read or written",
    7: "the executor was lost; the same command continues",
    130: "interrupted (143: terminated)",
}
#: Ctrl-C, of which a compiled module may make an error of its own, or nothing
_PRESSED = Event()
#: labs: companion tools with commands of their own, and a first command for each of their templates
LABS = {
    "shpb": "lab: records of Hopkinson bars, contact laws, test plans",
    "comminution": "lab: single-particle tests, feeds under impact",
}
LAB_TEMPLATES = {
    "lab_gauge_records": "uqsphere shpb records",
    "lab_limestone_feed": "uqsphere comminution feed",
}


def program() -> int:
    """The exit code of a command, its errors as one message."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # closed: no file of ours may take its place
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115
    with contextlib.suppress(OSError, ValueError):
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="replace")
    gc.set_threshold(1_000_000)  # imports make objects that stay: few are worth a search for cycles
    if not sys.warnoptions:  # NumPy's are for developers; ours are printed
        warnings.simplefilter("ignore")
    # not of a job that ignores it
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _press)
    sys.unraisablehook = _tell_unraisable
    try:
        code = main(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:
        # the reader has gone: no output is possible
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    gc.freeze()  # nothing is searched for cycles at the end of the process
    return code


def main(argv: Sequence[str]) -> int:
    """Run a command; returns its exit code."""
    if argv and argv[0] in LABS and find_spec("uqsphere.labs"):
        return _guarded(lambda: import_module("uqsphere.labs.files").run_command(*argv))
    parser = _parser()
    if "_ARGCOMPLETE" in os.environ:  # set by the shell that asks for completions
        with contextlib.suppress(ImportError):
            import argcomplete

            argcomplete.autocomplete(parser)
    options, unknown = parser.parse_known_args(argv)
    if options.version:
        from uqsphere.propagation.write import versions

        print("\n".join(f"{name} {number}" for name, number in versions().items()))
        return 0
    if not getattr(options, "command", None):
        parser.print_help()
        return 2
    if unknown:
        command = f"uqsphere {argv[0]}"
        tell(f"{command}: unknown option {unknown[0]}; see {command} --help")
        return 2
    return _guarded(lambda: options.command(options) or 0)


def _press(*_: object) -> NoReturn:
    _PRESSED.set()
    raise KeyboardInterrupt


def _tell_unraisable(raised: "sys.UnraisableHookArgs") -> None:
    if not _PRESSED.is_set():
        sys.__unraisablehook__(raised)


def _guarded(command: Callable[[], int]) -> int:
    try:
        return command()
    except BrokenPipeError:
        raise
    except (Exception, KeyboardInterrupt) as error:
        if _PRESSED.is_set() or isinstance(error, KeyboardInterrupt):
            tell("interrupted")
            return INTERRUPTED
        if isinstance(error, UqsphereError):
            tell(error)
            return error.exit_code
        if isinstance(error, MemoryError):
            tell("out of memory: use -j 1, or lower analysis.budget.evaluations")
            return 6
        if isinstance(error, OSError):
            tell(f"{error.filename or ''}: {error.strerror or error}".lstrip(": "))
            return 6
        if os.environ.get("UQSPHERE_DEBUG"):
            raise
        tell(
            f"internal error: {type(error).__name__}: {error}\nPlease report it with the study; "
            "UQSPHERE_DEBUG=1 shows where it happened."
        )
        return 1


# --- the parser -----------------------------------------------------------------------------------


class _Parser(ArgumentParser):
    """A parser of paths and counts whose error names the command that was probably meant."""

    def __init__(self, **options: Any) -> None:
        super().__init__(formatter_class=RawDescriptionHelpFormatter, **options)
        self.register("type", "path", Path)
        self.register("type", "count", _count)

    def error(self, message: str) -> NoReturn:
        word, _, choices = message.partition(": invalid choice: ")[2].partition(" (choose from ")
        if choices:
            from uqsphere.documents import suggestion

            names = choices.rstrip(")").replace("'", "").split(", ")
            what = "command" if self.prog == "uqsphere" else "choice"
            hint = suggestion(word.strip("'"), names)
            message = f"unknown {what} {word}{hint} (known: {', '.join(names)})"
        super().error(message)


def _parser() -> ArgumentParser:
    """The parser of all commands, with the arguments of `arguments.toml`."""
    codes = "\n".join(f"  {code:<4}{text}" for code, text in EXIT_CODES.items())
    parser = _Parser(
        prog="uqsphere",
        description="Fracture risk and uncertainty quantification of brittle spheres under impact.",
        epilog="start with:\n  uqsphere new granite -o rock.toml\n  uqsphere run rock.toml\n\n"
        f"exit codes:\n{codes}",
    )
    parser.add_argument(
        "--version", action="store_true", help="versions of uqsphere and its dependencies"
    )
    commands = parser.add_subparsers(metavar="COMMAND")
    parsers = {}
    for command in (
        _new,
        _check,
        _run,
        _sweep,
        _report,
        _compare,
        _history,
        _verify,
        _list,
        _schema,
        _bench,
    ):
        # the docstring has the help and the examples
        text, _, *examples = (getdoc(command) or "\n\n").splitlines()
        heading = "example:" if len(examples) == 1 else "examples:"
        name = command.__name__[1:]
        parsers[name] = commands.add_parser(
            name,
            help=text[:1].lower() + text[1:-1],
            description=text,
            epilog="\n  ".join([heading, *examples]),
        )
        parsers[name].set_defaults(command=command)
    for options in packaged("arguments.toml")["arguments"]:
        names = options.pop("names")
        for name in options.pop("commands"):
            argument = parsers[name].add_argument(*names, **options)
            if argument.dest == "template":
                argument.completer = lambda **_: _templates()  # type: ignore[attr-defined]
    if find_spec("uqsphere.labs"):
        for name, text in LABS.items():
            commands.add_parser(name, help=text)
    return parser


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise ArgumentTypeError(f"{text!r} must be a positive integer")
    return int(text)


# --- what commands share --------------------------------------------------------------------------


def _loaded(options: Namespace) -> Any:
    """The study of a command; its warnings go to stderr."""
    study = _reader(options)(())
    _warn(study.warnings)
    return study


def _reader(options: Namespace) -> Callable[[Sequence[str]], Any]:
    """A function that gives the study of a file or of standard input, with more PATH=VALUE set."""
    from uqsphere.documents import LARGEST, decoded
    from uqsphere.study import load_study

    path = options.file
    text = None
    if str(path) == "-":
        path = "stdin"
        content = sys.stdin.buffer.read(LARGEST + 1)
        if len(content) > LARGEST:
            raise UsageError(f"stdin: at most {LARGEST >> 20} MiB are read")
        text = decoded(content, path)
    return lambda more: load_study(path, [*options.overrides, *more], text=text)


def _warn(warnings: Iterable[str]) -> None:
    for warning in warnings:
        tell(f"warning: {warning}")


def _folder(options: Namespace, what: str) -> Path:
    """The directory of a command's results: the one requested, or one named after the study."""
    if options.out:
        return Path(options.out)
    stem = "study" if str(options.file) == "-" else options.file.stem
    return Path(f"{stem}-{what}")


def _budget(options: Namespace) -> float | None:
    """The time budget [s] of the command line; None without one."""
    from uqsphere.units import parse_value

    if options.budget is None:
        return None
    try:
        seconds = parse_value(options.budget, "time", "min")
    except ValueError as error:
        raise UsageError(f"--budget: {error}") from None
    if seconds <= 0.0:
        raise UsageError(f"--budget must be a positive time such as 10min, not {options.budget!r}")
    return seconds


def _width() -> int:
    """Columns of the terminal that a summary may use."""
    from shutil import get_terminal_size

    return max(min(get_terminal_size().columns - 1, 99), 20)


@contextlib.contextmanager
def _interruptible() -> Iterator[Callable[[], bool]]:
    """Whether the user has pressed Ctrl-C: once keeps what is complete, twice aborts."""

    def press(*_: object) -> None:
        _PRESSED.set()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        tell("\nStopping; completed model runs are kept. Press Ctrl-C again to abort.")

    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, press)
    try:
        yield _PRESSED.is_set
    finally:
        signal.signal(signal.SIGINT, before)
        _PRESSED.clear()


def _cluster(options: Namespace) -> Any:
    """A context with the client of the Dask cluster of a command; with None without one."""
    if options.dask is None:
        return contextlib.nullcontext()
    try:
        client_of = import_module("distributed").Client
    except ImportError:
        raise UsageError('--dask needs Dask: pip install "uqsphere[dask]"') from None
    key = "scheduler_file" if Path(options.dask).is_file() else "address"
    try:
        return client_of(**{key: options.dask}, timeout="20s")
    except Exception as error:  # a file of another kind can raise anything
        raise UsageError(f"--dask: no scheduler at {options.dask} ({error!r})") from None


# --- commands -------------------------------------------------------------------------------------


def _templates() -> dict[str, Path]:
    """Shipped studies, and input files of labs, by name."""
    from uqsphere.study import shipped_studies

    shipped = shipped_studies()
    folder = next(iter(shipped.values())).parent
    return shipped | {path.stem: path for path in sorted(folder.glob("lab_*.toml"))}


def _new(options: Namespace) -> None:
    """Write a commented study to start from.

    uqsphere new
    uqsphere new granite
    uqsphere new ishigami -o mine.toml
    """
    from uqsphere.documents import suggestion

    shipped = _templates()
    template = options.template
    if template is None:
        print("\n".join(shipped))
        return
    if template not in shipped:
        raise UsageError(
            f"unknown template {template!r}{suggestion(template, shipped)} (known: "
            f"{', '.join(shipped)})"
        )
    source = shipped[template]
    target = options.output or Path(source.name)
    if not target.parent.is_dir():
        raise UsageError(
            f"{target.parent} is not a directory: create it, or choose another path with -o"
        )
    files = {target: source.read_bytes()}
    for path in sorted(source.parent.iterdir()):
        if path.suffix in (".csv", ".py") and path.name.encode() in files[target]:
            files[target.parent / path.name] = path.read_bytes()
    for place, content in files.items():
        if place.exists() and not (place.is_file() and place.read_bytes() == content):
            raise UsageError(
                f"{place} exists with other content: rename it, or choose another directory "
                "with -o; nothing was written"
            )
    for place, content in files.items():
        if place.exists():
            print(f"{place} is already there")
        else:
            place.write_bytes(content)
            print(f"wrote {place}")
    print(f"next: {LAB_TEMPLATES.get(template, 'uqsphere check')} {target}")


def _check(options: Namespace) -> None:
    """Validate a study; print inputs and strengths as read, and the expected cost of a run.

    uqsphere check rock.toml
    uqsphere check rock.toml --set sphere.radius='12 mm'
    uqsphere check - < rock.toml
    """
    from uqsphere.models.scene import check_scene
    from uqsphere.report.study import cost, described

    study = _loaded(options)
    check_scene(study)
    print(described(study), flush=True)  # what follows loads the integrator, and times it
    print(f"\n{cost(study)}")


def _exit_code(runs: Iterable[Any]) -> int:
    """NOT_MET if any decision with a target is not met."""
    decisions = chain.from_iterable(run.results.decisions for run in runs)
    if any(each.target and each.verdict != "met" for each in decisions):
        return NOT_MET
    return 0


def _computed(
    options: Namespace, study: Any, folder: Path, stop: Callable[[], bool], **further: Any
) -> Any:
    """The run of a study, with its progress on stderr."""
    from uqsphere.propagation import run
    from uqsphere.propagation.progress import watched

    with watched(lines=True) as progress:
        return run(
            study,
            options.model,
            out=folder,
            threads=options.processes,
            seconds=_budget(options),
            progress=progress,
            stop=stop,
            **further,
        )


def _run(options: Namespace) -> int:
    """Run a study; write its results and its report.

    uqsphere run rock.toml
    uqsphere run rock.toml --out slower --set striker.speed.mean='0.4 m/s'
    uqsphere run ishigami.toml --model ishigami.py:ishigami -j 4
    uqsphere run ishigami.toml --model ishigami.py:ishigami --dask tcp://head:8786
    """
    study = _loaded(options)
    folder = _folder(options, "results")
    if options.dask is not None and not study.black_box:
        raise UsageError(
            "run --dask distributes the model runs of a black box; the impact model runs in this "
            "process, on the threads of -j"
        )
    with _cluster(options) as client, _interruptible() as stop:
        finished = _computed(options, study, folder, stop, executor=client, fresh=options.fresh)
    if options.json:
        print(finished.results.to_json(), end="")
    else:
        from uqsphere.report import summary

        print(summary(finished.results, _width()))
        print(f"report: {folder / 'report.html'}")
    if finished.results.accuracy.stopped == "interrupted":
        return INTERRUPTED
    return _exit_code([finished])


def _sweep(options: Namespace) -> int:
    """Run a study for each value of one or two keys, and tabulate the number to use.

    uqsphere sweep chute.toml --over target.thickness="10 mm, 15 mm, 25 mm"
    uqsphere sweep chute.toml --over sphere.radius="8 mm, 10 mm" --over rig.angle="60 deg, 90 deg"
    """
    from uqsphere.report.sweep import finished_run, plan_sweep, sweep_text, write_sweep

    folder = _folder(options, "sweep")
    sweep = plan_sweep(options.over, folder, _reader(options))
    _warn(dict.fromkeys(chain.from_iterable(point.study.warnings for point in sweep.points)))
    runs = sweep.runs

    def take_in(points: Iterable[Any]) -> None:
        """Write the page with those of some points that have run."""
        for point in points:
            run = finished_run(sweep, point)
            if run:
                runs[point.name] = run
        if runs:
            write_sweep(sweep)

    take_in(sweep.points)
    waiting = [point for point in sweep.points if point.name not in runs]
    with _interruptible() as stop:
        for point in waiting:
            if stop():
                break
            values = ", ".join(f"{key} = {value}" for key, value in point.values.items())
            tell(f"point {sweep.points.index(point) + 1} of {len(sweep.points)}: {values}")
            _computed(options, point.study, sweep.folder / point.name, stop)
            take_in([point])
    if runs:
        print(sweep_text(sweep, _width()))
        print(f"report: {folder / 'report.html'}")
    if len(runs) < len(sweep.points):
        return INTERRUPTED
    return _exit_code(runs.values())


def _report(options: Namespace) -> None:
    """Write the report again from stored results.

    uqsphere report rock-results
    """
    from uqsphere.report import write_page

    print(f"wrote {write_page(options.folder)}")


def _compare(options: Namespace) -> None:
    """Compare runs: decisions first, then settings that differ and answers that changed.

    uqsphere compare rock-results slower
    uqsphere compare rock-results slower --csv changes.csv
    """
    from uqsphere.report.compare import compare, comparison_text
    from uqsphere.results import open_run

    runs = [*map(open_run, options.folders)]
    names = [*map(str, options.folders)]
    print(comparison_text(runs, names))
    if options.csv:
        compare(runs, names).to_csv(options.csv, index=False)
        print(f"wrote {options.csv}")


def _history(options: Namespace) -> None:
    """One impact over time, every number at its mean: forces, pressures, gauges, x-t diagram.

    uqsphere history rock.toml
    uqsphere history rock.toml --out rock-history
    """
    from uqsphere.propagation import check_owner
    from uqsphere.report.history import history, history_rows, write_history
    from uqsphere.results.folder import locked

    study = _loaded(options)
    course = history(study)
    rows = [*history_rows(course)]
    width = min(max(len(text) for text, _ in rows), 88)
    print(f"{study.title}: one impact, every number at its mean")
    print("\n".join(f"{text:{width}}  {value}" for text, value in rows))
    if options.out:
        with locked(options.out, study.scene):
            check_owner(options.out, study, scene_only=True)
            for name in write_history(course, options.out):
                print(f"wrote {options.out / name}")


def _verify(options: Namespace) -> None:
    """Check a results directory against its checksums.

    uqsphere verify rock-results
    uqsphere verify rock-results --again
    """
    from uqsphere.results import open_run
    from uqsphere.results.folder import damaged_files

    wrong = damaged_files(options.folder)
    if wrong:
        raise FolderError(f"{options.folder}: damaged or missing: {', '.join(wrong[:8])}")
    print(f"{options.folder}: all checksums match (log.txt and cache.sqlite have none)")
    if not options.again:
        return
    from uqsphere.propagation import run
    from uqsphere.report.compare import compare, comparison_text
    from uqsphere.results.run import stored_study

    before = open_run(options.folder)
    after = run(stored_study(options.folder, before.results), options.model)
    both = [before, after], ["before", "again"]
    rows, others = (
        each.answers.dropna(subset="value").value_counts(["subject", "answer"]) for each in both[0]
    )
    apart = rows.sub(others, fill_value=0)
    lines = [f"not in both runs: {', '.join(place)}" for place in apart[apart != 0].index[:8]]
    # on another processor, or with another version of NumPy, answers differ by rounding
    if lines or compare(*both)["change"].abs().max() > 1e-9:
        told = ["run again, the answers differ:", *lines, comparison_text(*both)]
        raise FolderError("\n".join(told))
    print("run again: the answers are the same to 1e-9")


def _list(options: Namespace) -> None:
    """List materials, quantities, criteria or distributions.

    uqsphere list materials
    """
    from uqsphere.report.study import listing

    print(listing(options.what))


def _schema(options: Namespace) -> None:
    """Print the JSON schema of a study file, for editors, or of results.

    uqsphere schema > study.json
    uqsphere schema results > results.json
    """
    if options.what == "results":
        from uqsphere.results.types import Results

        schema = Results.model_json_schema(mode="serialization")
    else:
        from uqsphere.study import json_schema

        schema = json_schema()
    print(json.dumps(schema, ensure_ascii=False))


def _bench(options: Namespace) -> None:
    """Time the integrator against others at equal error.

    uqsphere bench --rows 256
    """
    from uqsphere.bench import bench_text

    print(bench_text(options.study, rows=options.rows))
