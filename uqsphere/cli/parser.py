"""The parser of all commands and their options; nothing heavy is imported for it."""

from __future__ import annotations

import argparse
from pathlib import Path

import uqsphere
from uqsphere.errors import UsageError

__all__ = ["build_parser"]

_EPILOG = """exit codes: 0 ok, 1 internal error, 2 invalid study or usage, 3 a target was not met, 4 too many failed
evaluations, 5 result folder locked, foreign or damaged, 6 input/output, 130 or 143 interrupted"""


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
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_Parser)

    def command(name: str, text: str) -> argparse.ArgumentParser:
        return commands.add_parser(name, help=text, description=text)

    new = command("new", "write a commented study to start from")
    new.add_argument(
        "template", nargs="?", default="granite", metavar="TEMPLATE", help="name of a shipped study (default: granite)"
    )
    new.add_argument("-o", "--output", required=True, metavar="FILE", type=Path)
    new.add_argument("--json", action="store_true", help="print one JSON document on stdout")

    check = command("check", "validate a study; print the resolved scene and what a run will cost")
    run = command("run", "run a study and write its report")
    history = command("history", "one deterministic scene over time, all numbers at their means")
    for study in (check, run, history):
        study.add_argument("study", metavar="FILE", type=Path)
        study.add_argument(
            "--set",
            dest="overrides",
            action="append",
            default=[],
            metavar="PATH=VALUE",
            help='replace a value of the study, such as striker.speed.mean="0.6 m/s"; margins=null takes it out',
        )
        study.add_argument("--json", action="store_true", help="print one JSON document on stdout")
    run.add_argument("--out", type=Path, metavar="DIR", help="result folder (default: the study's name + -results)")
    run.add_argument("-j", "--jobs", type=int, metavar="N", help="processors to use (default: all)")
    run.add_argument("--budget", metavar="TIME", help='time budget in place of the study\'s, such as "10min"')
    again = run.add_mutually_exclusive_group()
    again.add_argument("--resume", action="store_true", help="go on with what is stored (the default)")
    again.add_argument("--fresh", action="store_true", help="drop what is stored and begin again")
    again.add_argument("--extend", action="store_true",
                       help="let a study that asks more of the same inputs go on with what DIR holds")  # fmt: skip
    run.add_argument("--dask", metavar="ADDRESS",
                     help='evaluate on a Dask cluster: "tcp://HOST:8786" of its scheduler, or "local" for one of this '
                     "machine's processes (-j of them)")  # fmt: skip
    run.add_argument("--model", metavar="FILE.py:FUNCTION", help="the model of a black-box study; THIS RUNS THE FILE")
    history.add_argument("--out", type=Path, metavar="DIR", help="write history.csv and the figures here")

    report = command("report", "build the report again from what is stored")
    show = command("show", "the answers of a run as a table")
    export = command("export", "samples and tables of a run in another format")
    verify = command("verify", "checksums of everything stored, and some of it evaluated again")
    for folder in (report, show, export, verify):
        folder.add_argument("folder", metavar="DIR", type=Path)
        folder.add_argument("--json", action="store_true", help="print one JSON document on stdout")
    report.add_argument("--pdf", action="store_true", help="also as report.pdf (needs the extra: uqsphere[pdf])")
    export.add_argument("--format", required=True, choices=("csv", "parquet", "json"))
    export.add_argument("--out", type=Path, metavar="DIR", help="where to write (default: DIR/export)")
    verify.add_argument("--chunks", type=int, default=3, metavar="N", help="chunks to evaluate again (default 3)")
    verify.add_argument("--seed", type=int, default=0, help="which of them (default 0)")
    verify.add_argument("--model", metavar="FILE.py:FUNCTION", help="the model of a black box; THIS RUNS THE FILE")
    compare = command("compare", "two runs side by side: what changed, by how much, and whether that is significant")
    compare.add_argument("before", metavar="DIR", type=Path)
    compare.add_argument("after", metavar="DIR", type=Path)
    compare.add_argument("--out", type=Path, metavar="FILE.html", help="write a page with figures")
    compare.add_argument("--json", action="store_true", help="print one JSON document on stdout")

    given = command("analyse", "laws, dependence and drivers from a table of runs that were made already")
    given.add_argument("data", metavar="DATA.csv", type=Path)
    given.add_argument("--inputs", required=True, metavar="A,B", help="columns that went in, divided by commas")
    given.add_argument("--outputs", required=True, metavar="Y,Z", help="columns that came out")
    given.add_argument(
        "--laws", type=Path, metavar="STUDY.toml", help="the laws that the runs were drawn from, if known"
    )
    given.add_argument("--out", type=Path, metavar="DIR", help="write analysis.json and inputs.toml here")
    given.add_argument("--json", action="store_true", help="print one JSON document on stdout")

    from uqsphere.experiment import add_records
    from uqsphere.planning.command import add_plan

    add_records(command("records", "pulse, contact forces and stiffness from records of strain gauges"))

    add_plan(command("plan", "speeds, ramps and lengths at which a sphere breaks as wanted, between elastic bars"))

    listing = command("list", "what there is to choose from")
    listing.add_argument("what", choices=("materials", "models", "quantities", "criteria"))
    listing.add_argument("--json", action="store_true", help="print one JSON document on stdout")
    from uqsphere.bench.command import add_bench

    add_bench(command("bench", "speed against error on this machine, and evidence for the uncertainty engine"))
    schema = command("schema", "print the JSON schema of study files, for editors")
    schema.add_argument("--json", action="store_true", help="the same: a schema is a JSON document")
    doctor = command("doctor", "check this installation")
    doctor.add_argument("--json", action="store_true", help="print one JSON document on stdout")
    return parser
