"""The parser of all commands and their options; nothing heavy is imported for it."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import uqsphere
from uqsphere.errors import UsageError

_EPILOG = """exit codes: 0 ok, 1 internal error, 2 invalid study or usage, 3 a target was not met, 4 too many failed
evaluations, 5 result folder locked, foreign or damaged, 6 input/output, 130 or 143 interrupted"""

#: adds a command: its name, what it does, and the module that does it in its function `command_NAME`
Command = Callable[[str, str, str], argparse.ArgumentParser]


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

    def command(name: str, text: str, module: str) -> argparse.ArgumentParser:
        made = commands.add_parser(name, help=text, description=text)
        made.set_defaults(module=module)
        return made

    _add_studies(command)
    _add_folders(command)
    _add_data(command)
    _add_others(command)
    return parser


def _json(parser: argparse.ArgumentParser, text: str = "print one JSON document on stdout") -> None:
    parser.add_argument("--json", action="store_true", help=text)


def _set(parser: argparse.ArgumentParser) -> None:
    text = 'replace a value of the study, such as striker.speed.mean="0.6 m/s"; margins=null takes it out'
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="PATH=VALUE", help=text)


def _add_studies(command: Command) -> None:
    """Commands that begin with a study."""
    new = command("new", "write a commented study to start from", "uqsphere.cli.studies")
    new.add_argument(
        "template",
        nargs="?",
        default="granite",
        metavar="TEMPLATE",
        help="a name of `uqsphere list templates` (default: granite)",
    )
    new.add_argument("-o", "--output", required=True, metavar="FILE", type=Path)
    _json(new)

    check = command(
        "check", "validate a study; print the resolved scene and what a run will cost", "uqsphere.cli.studies"
    )
    run = command("run", "run a study and write its report", "uqsphere.cli.run")
    history = command(
        "history", "one deterministic scene over time, all numbers at their means", "uqsphere.cli.studies"
    )
    for study in (check, run, history):
        study.add_argument("study", metavar="FILE", type=Path)
        _set(study)
        _json(study)
    history.add_argument("--out", type=Path, metavar="DIR", help="write history.csv and the figures here")
    run.add_argument("--out", type=Path, metavar="DIR", help="result folder (default: the study's name + -results)")
    run.add_argument("-j", "--jobs", type=int, metavar="N", help="processors to use (default: all)")
    run.add_argument("--budget", metavar="TIME", help='time budget in place of the study\'s, such as "10min"')
    again = run.add_mutually_exclusive_group()
    again.add_argument("--resume", action="store_true", help="go on with what is stored (the default)")
    again.add_argument("--fresh", action="store_true", help="drop what is stored and begin again")
    more = "let a study that asks more of the same inputs go on with what DIR holds"
    again.add_argument("--extend", action="store_true", help=more)
    where = '"tcp://HOST:8786" of its scheduler, or "local" for one of this machine\'s processes (-j of them)'
    run.add_argument("--dask", metavar="ADDRESS", help=f"evaluate on a Dask cluster: {where}")
    run.add_argument(
        "--model",
        metavar="FILE.py:FUNCTION",
        help="the model of a black-box study, or FILE.toml that names a program; THIS RUNS IT",
    )


def _add_folders(command: Command) -> None:
    """Commands that look at the folder of a run."""
    home = "uqsphere.cli.folders"
    report = command("report", "build the report again from what is stored", home)
    show = command("show", "the answers of a run as a table", home)
    export = command("export", "samples and tables of a run in another format", home)
    verify = command("verify", "checksums of everything stored, and some of it evaluated again", home)
    for folder in (report, show, export, verify):
        folder.add_argument("folder", metavar="DIR", type=Path)
        _json(folder)
    report.add_argument("--pdf", action="store_true", help="also as report.pdf (needs the extra: uqsphere[pdf])")
    report.add_argument(
        "--brief", action="store_true", help="the one sheet alone, as brief.html (with --pdf as brief.pdf)"
    )
    report.add_argument("--full", action="store_true", help="with --pdf: methods, tables and words in print too")
    export.add_argument("--format", required=True, choices=("csv", "parquet", "json"))
    export.add_argument("--out", type=Path, metavar="DIR", help="where to write (default: DIR/export)")
    verify.add_argument("--chunks", type=int, default=3, metavar="N", help="chunks to evaluate again (default 3)")
    verify.add_argument("--seed", type=int, default=0, help="which of them (default 0)")
    verify.add_argument("--model", metavar="FILE.py:FUNCTION", help="the model of a black box; THIS RUNS THE FILE")
    compare = command(
        "compare", "two runs side by side: what changed, by how much, and whether that is significant", home
    )
    compare.add_argument("before", metavar="DIR", type=Path)
    compare.add_argument("after", metavar="DIR", type=Path)
    compare.add_argument("--out", type=Path, metavar="FILE.html", help="write a page with figures")
    _json(compare)


def _add_data(command: Command) -> None:
    """Commands that begin with data, or with the design of a test."""

    given = command("analyse", "laws, dependence and drivers from a table of runs that were made already",
                    "uqsphere.cli.data")  # fmt: skip
    given.add_argument("data", metavar="DATA.csv", type=Path)
    given.add_argument("--inputs", required=True, metavar="A,B", help="columns that went in, divided by commas")
    given.add_argument("--outputs", required=True, metavar="Y,Z", help="columns that came out")
    given.add_argument(
        "--laws", type=Path, metavar="STUDY.toml", help="the laws that the runs were drawn from, if known"
    )
    given.add_argument("--out", type=Path, metavar="DIR", help="write analysis.json and inputs.toml here")
    _json(given)
    records = "pulse, contact forces and stiffness from records of strain gauges"
    _add_records(command("records", records, "uqsphere.cli.records"))
    _add_fit(command("fit-contact", "onset, hardness and pile-up from a slow test on a sphere between two platens",
                     "uqsphere.cli.records"))  # fmt: skip
    _add_feed(command)
    plan = "what breaks a sphere as wanted: speeds, ramps and lengths between bars, the one number of another rig"
    _add_plan(command("plan", plan, "uqsphere.cli.plan"))


def _add_feed(command: Command) -> None:
    """Commands of single particles, feeds and DEM."""
    home = "uqsphere.cli.feed"
    fit = command("fit", "the law of fracture energy that tests of single particles leave open", home)
    fit.add_argument("study", metavar="FILE", type=Path, help="with a table [tests]")
    _set(fit)
    fit.add_argument("--out", type=Path, metavar="DIR", help="where to write (default: the study's name + -fit)")
    _json(fit)
    tests = command("plan-tests", "how many more tests of single particles, and which tells most", home)
    tests.add_argument("study", metavar="FILE", type=Path)
    _set(tests)
    wanted = "95 %% half-width that is wanted: of an energy relative, of a share as it is (default 0.2)"
    tests.add_argument("--precision", type=float, default=0.2, metavar="X", help=wanted)
    tests.add_argument("--at", metavar="SIZE", help='aim at the energy that breaks half at this size, such as "20 mm" '
                       "(default: the share broken of [feed], else the largest tested size)")  # fmt: skip
    _json(tests)
    feed = command("feed", "what becomes of a feed under its blows, from tests of its particles", home)
    feed.add_argument("study", metavar="FILE", type=Path)
    _set(feed)
    feed.add_argument("--fit", type=Path, metavar="DIR", help="a posterior of `uqsphere fit`, in place of [tests]")
    feed.add_argument("--out", type=Path, metavar="DIR", help="where to write (default: the study's name + -feed)")
    _json(feed)
    export = command("export-dem", "draws of a feed's parameters for a DEM program, as it names them", home)
    export.add_argument("folder", metavar="DIR", type=Path, help="what `uqsphere feed` wrote")
    export.add_argument("--to", required=True, choices=("rocky", "liggghts", "edem", "csv"))
    export.add_argument("--draws", type=int, default=20, metavar="N", help="spread over the share broken (default 20)")
    factor = "E_inf is multiplied by it: 1 + k_p/k_s of the test rig, where the program divides (default: not)"
    export.add_argument("--rig-factor", type=float, metavar="X", help=factor)
    export.add_argument("--out", type=Path, metavar="DIR", help="where to write (default: DIR/dem)")
    _json(export)


def _add_plan(parser: argparse.ArgumentParser) -> None:
    """The options of `uqsphere plan`."""
    parser.add_argument("study", metavar="FILE", type=Path)
    _set(parser)
    parser.add_argument("--speed", metavar="LOW,HIGH", help="striker speeds, m/s unless a unit stands there "
                        "(default: those of the margins, or a decade about the study's)")  # fmt: skip
    parser.add_argument("--rise", metavar="LOW,HIGH", help="ramps of the pulse, us unless a unit stands there "
                        "(default: 0 up to the length of the pulse)")  # fmt: skip
    parser.add_argument("--length", metavar="L[,L]", help="striker lengths, m unless a unit stands there "
                        "(default: the study's)")  # fmt: skip
    parser.add_argument("--imbalance", type=float, default=0.1, metavar="X",
                        help="largest |P_A - P_B| at fracture over the larger force (default 0.1)")  # fmt: skip
    parser.add_argument("--quantile", type=float, default=0.5, metavar="P",
                        help="the specimen that is shown: quantile of the strength (default 0.5)")  # fmt: skip
    parser.add_argument("--grid", default="60x41", metavar="NxM", help="speeds and ramps of the map (default 60x41)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write plan.csv, windows.csv and the figure here")
    _json(parser)


def _add_records(parser: argparse.ArgumentParser) -> None:
    """The options of `uqsphere records`."""
    parser.add_argument("record", metavar="FILE", type=Path, help="time and one signal, two gauges or three waves, or "
                        "two gauges a bar; or a folder of such files")  # fmt: skip
    parser.add_argument("--study", type=Path, metavar="STUDY", help="sphere and bars; needed for forces")
    _set(parser)
    parser.add_argument(
        "--columns",
        metavar="T,A,B",
        help="columns that count, by name or number: time, then signals; gauges of a bar as A+B",
    )
    parser.add_argument("--with", dest="beside", action="append", default=[], type=Path, metavar="FILE",
                        help="further channels of the same shot, in a file of their own")  # fmt: skip
    parser.add_argument("--unit", default="", help="unit of the signals, such as microstrain or mV")
    parser.add_argument("--time-unit", default="", help="unit of the time, such as us")
    parser.add_argument("--sample-interval", default="", metavar="TIME", help="for a file without a time")
    parser.add_argument("--gauge-factor", default="2", metavar="K[,K]", help="one, or one for each bar")
    parser.add_argument("--excitation", default="0", metavar="V[,V]", help="supply of the bridge, volts")
    parser.add_argument("--amplification", default="1", metavar="A[,A]")
    parser.add_argument("--active-arms", default="1", metavar="N[,N]", help="1 quarter, 2 half bridge")
    parser.add_argument("--incident-gauge", default="0 m", metavar="LENGTH", help="its distance from the sphere")
    parser.add_argument("--receiving-gauge", default="0 m", metavar="LENGTH", help="its distance from the sphere")
    parser.add_argument("--window", metavar="BEGIN,END", help='times of the incident wave, such as "100 us,420 us"')
    parser.add_argument("--polarity", choices=("auto", "tension", "compression"), default="auto",
                        help="what is positive in the record (default: the first wave presses)")  # fmt: skip
    parser.add_argument("--correct-dispersion", action="store_true", help="carry the waves from gauges to faces")
    parser.add_argument("--receiving-bar", metavar="KEYS", help='where it is another: "E=72 GPa, density=2810 kg/m3"')
    parser.add_argument("--specimen", choices=("sphere", "other"), default="sphere",
                        help="other: forces and energies alone, no elastic sphere is fitted")  # fmt: skip
    parser.add_argument("--bound", default="", metavar="FORCE", help="more than such a specimen can bear is doubted")
    parser.add_argument("--calibration", type=Path, metavar="FILE",
                        help="a shot without a specimen, wired alike: it gives bar speed and gains")  # fmt: skip
    parser.add_argument("--striker-speed", default="", metavar="SPEED", help="of the calibration shot")
    parser.add_argument("--pdf", action="store_true", help="the sheet on paper too, with --out")
    parser.add_argument(
        "--gain-sd", type=float, default=0.01, metavar="SD", help="of each gauge, relative (default 0.01)"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="write tables and figures here")
    _json(parser)


def _add_fit(parser: argparse.ArgumentParser) -> None:
    """The options of `uqsphere fit-contact`."""
    parser.add_argument("record", metavar="FILE.csv", type=Path, help="displacement and force, loaded and let go")
    parser.add_argument("--diameter", required=True, metavar="LENGTH", help='of the sphere, such as "20 mm"')
    parser.add_argument("--platens", default="rigid", metavar="NAME",
                        help="a material of the bars, or rigid; E of the sphere follows")  # fmt: skip
    parser.add_argument("--nu", type=float, default=0.25, help="Poisson ratio of the sphere (default 0.25)")
    parser.add_argument("--columns", metavar="D,F", help="columns that count: displacement, force")
    parser.add_argument("--displacement-unit", default="", metavar="UNIT", help="such as um")
    parser.add_argument("--force-unit", default="", metavar="UNIT", help="such as kN")
    parser.add_argument("--machine-stiffness", metavar="K", help='such as "100 kN/mm" (default: rigid)')
    parser.add_argument("--pile-up", type=float, metavar="C", help="where it is known, 1 to 3: it is not fitted then")
    _json(parser)


def _add_others(command: Command) -> None:
    """What there is, and this installation."""
    listing = command("list", "what there is to choose from", "uqsphere.cli.data")
    listing.add_argument("what", choices=("materials", "models", "quantities", "criteria", "templates"))
    _json(listing)
    bench = command("bench", "speed against error on this machine", "uqsphere.bench")
    bench.add_argument("--quick", action="store_true", help="fewer of everything: a minute instead of ten or more")
    bench.add_argument("--measured", action="store_true", help="the model beside published measurements instead")
    bench.add_argument("--out", type=Path, metavar="DIR", help="where to write (default: bench-results)")
    _json(bench)
    serve = command("serve", "the impact model of a study as an UM-Bridge server on this machine", "uqsphere.cli.serve")
    serve.add_argument("study", type=Path)
    serve.add_argument("--port", type=int, default=4242, help="where it listens (default: 4242)")
    _set(serve)
    _json(serve)
    schema = command("schema", "print the JSON schema of study files, for editors", "uqsphere.cli.studies")
    _json(schema, "the same: a schema is a JSON document")
    _json(command("doctor", "check this installation", "uqsphere.cli.doctor"))
