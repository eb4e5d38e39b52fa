"""The command line: one function a command.  stdout has the answer only, progress and notes go to
stderr.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from uqsphere.errors import UqsphereError, UsageError

#: exit codes beside those of errors: a target whose verdict is not met, and an interruption
NOT_MET, INTERRUPTED = 3, 130
#: labs: products beside the product, with commands of their own
LABS = ("shpb", "comminution")


def program() -> None:
    """The entry point: the exit code of a command, errors as one message."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # closed: no file of ours may take its place
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115
    with contextlib.suppress(AttributeError, OSError, ValueError):
        for stream in (sys.stdout, sys.stderr):
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    try:
        code = main(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:
        # whoever read has gone: nothing more can be told
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    sys.exit(code)


def main(argv: Sequence[str]) -> int:
    """Run a command; returns its exit code."""
    if argv and argv[0] in LABS and find_spec("uqsphere.labs") is not None:
        command = import_module(f"uqsphere.labs.{argv[0]}.cli").main
        return _guarded(lambda: int(command(list(argv[1:]))))
    parser = _parser()
    given = parser.parse_args(argv)
    if not getattr(given, "command", None):
        parser.print_help()
        return 2
    return _guarded(lambda: given.command(given) or 0)


def _guarded(command: Callable[[], int]) -> int:
    try:
        return command()
    except UqsphereError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        raise
    except MemoryError:
        print(
            "out of memory: fewer rows, fewer processes (-j 1) or a smaller study", file=sys.stderr
        )
        return 6
    except OSError as error:
        print(f"{error.filename or ''}: {error.strerror or error}".lstrip(": "), file=sys.stderr)
        return 6
    except Exception as error:
        if os.environ.get("UQSPHERE_DEBUG"):
            raise
        print(
            f"internal error: {type(error).__name__}: {error}\nPlease report it with the study; "
            "UQSPHERE_DEBUG=1 shows "
            "where it happened.",
            file=sys.stderr,
        )
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="uqsphere",
        description="Fracture risk and uncertainty of brittle spheres under impact.",
        epilog="Start with: uqsphere new granite -o rock.toml; uqsphere run rock.toml",
    )
    parser.add_argument(
        "--version", action=_Version, nargs=0, help="versions of uqsphere and of what it stands on"
    )
    commands = parser.add_subparsers(metavar="COMMAND")

    def add(
        name: str, command: Callable[[argparse.Namespace], int | None], text: str
    ) -> argparse.ArgumentParser:
        one = commands.add_parser(name, help=text, description=text[:1].upper() + text[1:] + ".")
        one.set_defaults(command=command)
        return one

    new = add("new", _new, "a commented study to start from")
    new.add_argument(
        "template",
        nargs="?",
        metavar="TEMPLATE",
        help="one of the shipped studies; without it they are listed",
    )
    new.add_argument("-o", "--output", type=Path, metavar="FILE", help="where to write it")
    check = add(
        "check",
        _check,
        "validate a study; inputs and strengths as understood, and about how long a run takes",
    )
    _with_study(check)
    run = add("run", _run, "run a study, and write its results and its page")
    _with_study(run)
    run.add_argument("--out", type=Path, metavar="DIR", help="folder of the results (FILE-results)")
    run.add_argument(
        "-j", "--processes", type=_count, metavar="N", help="threads, or processes of a black box"
    )
    run.add_argument(
        "--budget", metavar="TIME", help="time budget in place of the study's, such as 10min"
    )
    run.add_argument(
        "--model",
        metavar="FILE.py:FUNCTION",
        help="the model of a black-box study; this runs its code",
    )
    run.add_argument("--fresh", action="store_true", help="replace what is in the folder")
    run.add_argument(
        "--json", action="store_true", help="print results.json in place of the summary"
    )
    report = add("report", _report, "write the page of a result folder again, from what is stored")
    report.add_argument("folder", type=Path, metavar="DIR")
    compare = add(
        "compare",
        _compare,
        "runs side by side: what was set otherwise, which answers moved, by how much",
    )
    compare.add_argument("folders", type=Path, nargs="+", metavar="DIR")
    compare.add_argument("--csv", type=Path, metavar="FILE", help="write all answers")
    history = add(
        "history", _history, "one scene over time: forces, pressures, gauges, x-t diagram"
    )
    _with_study(history)
    history.add_argument("--out", type=Path, metavar="DIR", help="folder for table and figures")
    history.add_argument("--json", action="store_true", help="print the rows as JSON")
    verify = add("verify", _verify, "whether a result folder is whole")
    verify.add_argument("folder", type=Path, metavar="DIR")
    verify.add_argument(
        "--again", action="store_true", help="run the study again and compare the answers"
    )
    verify.add_argument(
        "--model", metavar="FILE.py:FUNCTION", help="the model of a black-box study"
    )
    listing = add("list", _list, "materials, quantities, criteria or distributions")
    listing.add_argument("what", choices=("materials", "quantities", "criteria", "distributions"))
    schema = add("schema", _schema, "the JSON schema of a study file, for editors, or of results")
    schema.add_argument("what", nargs="?", choices=("study", "results"), default="study")
    bench = add("bench", _bench, "speed against error: the integrator against others")
    bench.add_argument("--rows", type=_count, default=1024, metavar="N")
    if find_spec("uqsphere.labs") is not None:
        commands.add_parser(
            "shpb", help="lab: records of Hopkinson bars, contact laws, plans of tests"
        )
        commands.add_parser("comminution", help="lab: tests of single particles, feeds under blows")
    return parser


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from uqsphere.propagation.write import _versions

        print("\n".join(f"{name} {number}" for name, number in _versions().items()))
        parser.exit()


def _with_study(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, metavar="FILE")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        dest="overrides",
        help="a value in place of the study's, such as sphere.radius='12 mm'; may be given again",
    )


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: a whole number from 1 on is required")
    return int(text)


def _loaded(given: argparse.Namespace) -> Any:
    from uqsphere.study import load_study

    study = load_study(given.file, given.overrides)
    for warning in study.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    return study


# --- commands -------------------------------------------------------------------------------------


def _new(given: argparse.Namespace) -> None:
    from uqsphere.study import shipped_studies

    shipped = shipped_studies()
    folder = next(iter(shipped.values())).parent
    shipped |= {path.stem: path for path in sorted(folder.glob("lab_*.toml"))}
    if given.template is None:
        print("\n".join(shipped))
        return
    if given.template not in shipped:
        raise UsageError(f"there is no template {given.template!r} (known: {', '.join(shipped)})")
    source = shipped[given.template]
    target = given.output or Path(source.name)
    if not target.parent.is_dir():
        raise UsageError(
            f"{target.parent} is no folder: make it first, or choose another place with -o"
        )
    text = source.read_text(encoding="utf-8")
    named = (
        path
        for path in sorted(source.parent.iterdir())
        if path.suffix in (".csv", ".py") and path.name in text
    )
    for path in (source, *named):
        place = target if path is source else target.parent / path.name
        if place.exists():
            raise UsageError(f"{place} is there already: choose another name with -o")
        place.write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
        print(f"wrote {place}")
    print(f"next: uqsphere check {target}")


def _check(given: argparse.Namespace) -> None:
    from uqsphere.models.scene import check_scene
    from uqsphere.report.study import cost, described

    study = _loaded(given)
    if study.black_box or study.rig:
        check_scene(study)
    print(described(study), flush=True)  # what follows loads the integrator, and times it
    print(f"\n{cost(study)}")


def _run(given: argparse.Namespace) -> int:
    from uqsphere.propagation import run
    from uqsphere.propagation.progress import watched
    from uqsphere.units import parse_value

    study, seconds = _loaded(given), None
    if given.budget is not None:
        try:
            seconds = parse_value(given.budget, "time", "min")
        except ValueError as error:
            raise UsageError(f"--budget: {error}") from None
        if seconds <= 0.0:
            raise UsageError(
                f"--budget: {given.budget!r} is no time to compute: 10min, for example"
            )
    folder = given.out or Path(f"{given.file.stem}-results")
    with _interruptible() as stop, watched(lines=True) as progress:
        found = run(
            study,
            given.model,
            out=folder,
            threads=given.processes,
            seconds=seconds,
            progress=progress,
            stop=stop,
            fresh=given.fresh,
        )
    if given.json:
        print(found.results.to_json(), end="")
    else:
        from shutil import get_terminal_size

        from uqsphere.report import summary

        print(
            summary(
                found.results.model_dump(mode="json"),
                max(min(get_terminal_size().columns - 1, 99), 20),
            )
        )
        print(f"report: {folder / 'report.html'}")
    if found.results.accuracy.stopped == "interrupted":
        return INTERRUPTED
    open_targets = [
        v for v in found.verdicts.values() if v.target is not None and v.verdict != "met"
    ]
    return NOT_MET if open_targets else 0


@contextlib.contextmanager
def _interruptible() -> Iterator[Callable[[], bool]]:
    """Whether the user has pressed Ctrl-C: once ends with what is there, twice at once."""
    pressed: list[int] = []

    def press(*_: object) -> None:
        pressed.append(1)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        print("\nending with what is there; Ctrl-C again ends at once", file=sys.stderr)

    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, press)
    try:
        yield lambda: bool(pressed)
    finally:
        signal.signal(signal.SIGINT, before)


def _report(given: argparse.Namespace) -> None:
    from uqsphere.report import write_page

    print(f"wrote {write_page(given.folder)}")


def _compare(given: argparse.Namespace) -> None:
    from uqsphere.report.compare import compare, comparison_text
    from uqsphere.results import open_run

    runs = [open_run(folder) for folder in given.folders]
    names = [str(folder) for folder in given.folders]
    print(comparison_text(runs, names))
    if given.csv is not None:
        compare(runs, names).to_csv(given.csv, index=False)
        print(f"wrote {given.csv}")


def _history(given: argparse.Namespace) -> None:
    from uqsphere.report.history import history, history_rows, write_history
    from uqsphere.results.folder import locked

    study = _loaded(given)
    found = history(study)
    rows = history_rows(study, found)
    if given.json:
        print(json.dumps({"title": study.title, "rows": dict(rows)}, indent=1, ensure_ascii=False))
    else:
        width = min(max(len(text) for text, _ in rows), 88)
        print(f"{study.title}: one scene, every number at its mean")
        print("\n".join(f"{text:{width}}  {value}" for text, value in rows))
    if given.out is not None:
        with locked(given.out):
            for name in write_history(study, found, given.out):
                print(f"wrote {given.out / name}")


def _verify(given: argparse.Namespace) -> None:
    from uqsphere.errors import FolderError
    from uqsphere.results import open_run
    from uqsphere.results.folder import damaged_files

    wrong = damaged_files(given.folder)
    if wrong:
        raise FolderError(f"{given.folder}: damaged or missing: {', '.join(wrong[:8])}")
    print(f"{given.folder}: every file is as it was written")
    if not given.again:
        return
    from uqsphere.propagation import run
    from uqsphere.report.compare import comparison_text
    from uqsphere.study import load_study

    before = open_run(given.folder)
    text = (given.folder / "study.toml").read_text(encoding="utf-8")
    study = load_study(
        given.folder / "files" / "study.toml", before.results.study.overrides, text=text
    )
    after = run(study, given.model)
    if after.results.answers != before.results.answers:
        raise FolderError(
            "run again, the answers differ:\n"
            + comparison_text([before, after], ["before", "again"])
        )
    print(f"run again: all {len(before.results.answers)} answers are the same")


def _list(given: argparse.Namespace) -> None:
    from uqsphere.report.study import listing

    print(listing(given.what))


def _schema(given: argparse.Namespace) -> None:
    if given.what == "results":
        from uqsphere.results.types import Results

        schema = Results.model_json_schema(mode="serialization")
    else:
        from uqsphere.study import json_schema

        schema = json_schema()
    print(json.dumps(schema, ensure_ascii=False))


def _bench(given: argparse.Namespace) -> None:
    from uqsphere.bench import bench_text

    print(bench_text(rows=given.rows))
