"""The docs are true: snippets load, names and links exist, equations that are cited stand there, numbers come out."""

from __future__ import annotations

import argparse
import math
import re
import tomllib
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import ENDLESS
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import gamma
from test_broken_studies import BASE
from test_imports import FLOORS

import uqsphere
from tests.campaigns.pages import MOST_WORDS, words
from uqsphere import errors
from uqsphere.cli import build_parser
from uqsphere.cli.run import MISSED
from uqsphere.mechanics import as_printed
from uqsphere.mechanics.closed_form import linear_approaches, loading_time, massless_approach, relaxing_approach
from uqsphere.mechanics.contact import centre_tension
from uqsphere.mechanics.integrator import solve as dynamics
from uqsphere.mechanics.scene import Scene
from uqsphere.mechanics.validity import RULES
from uqsphere.quantities import INPUTS, OUTPUTS
from uqsphere.runner import campaign as stopping
from uqsphere.runner import schedule
from uqsphere.runner.questions import indices as sensitivity
from uqsphere.study import load_study
from uqsphere.study.document import LimitTable, PulseTable, SphereTable
from uqsphere.study.reference import with_tables
from uqsphere.study.tables import declared
from uqsphere.units import UNITS, units_of
from uqsphere.uq import indices
from uqsphere.uq.families import FAMILIES

ROOT = Path(__file__).parent.parent
PAGES = {path.relative_to(ROOT).as_posix(): path.read_text("utf-8")
         for path in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]}  # fmt: skip
THEORY, ERRATA = PAGES["docs/theory.md"], PAGES["docs/errata.md"]
STUDY_FILE, ARCHITECTURE = PAGES["docs/study-file.md"], PAGES["docs/architecture.md"]
SOURCES = {path.relative_to(ROOT).as_posix(): path.read_text("utf-8") for folder in ("uqsphere", "tests", "studies")
           for path in sorted((ROOT / folder).rglob("*.py"))}  # fmt: skip
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def prose(text: str) -> str:
    """A page without its fenced blocks."""
    return FENCE.sub("", text)


def section(text: str, heading: str) -> str:
    """What stands below a heading, down to the next of its rank or above."""
    marks = heading.split(" ")[0]
    found = re.search(rf"^{re.escape(heading)}.*?$(.*?)(?=^#{{1,{len(marks)}}} |\Z)", text, re.DOTALL | re.MULTILINE)
    return found[1]


def rows(text: str) -> list[list[str]]:
    """Cells of every row of the tables of a text, headings left out."""
    lines = re.findall(r"^\|(.*)\|$", text, re.MULTILINE)
    cells = [[cell.strip() for cell in line.split("|")] for line in lines]
    rules = {n for n, row in enumerate(cells) if set("".join(row)) <= set("-: ")}
    return [row for n, row in enumerate(cells) if n not in rules and n + 1 not in rules]


def ticked(text: str) -> list[str]:
    """What stands in backticks."""
    return re.findall(r"`([^`]+)`", text)


def test_what_a_newcomer_reads_has_short_sentences() -> None:
    others = [f"docs/{page}.md" for page in ("cluster", "what-changed", "measurements", "gallery", "api")]
    for name in ("README.md", *others, *(page for page in PAGES if "tutorial" in page)):
        text = re.sub(r"`[^`]*`", "x", re.sub(r"^(\||#).*$", "", prose(PAGES[name]), flags=re.MULTILINE))
        sentences = [part for block in text.split("\n\n") for part in re.split(r"(?<=[.!?;:*])\s+", block)]
        assert not [sentence for sentence in sentences if words(sentence) > MOST_WORDS], name


# --- snippets -------------------------------------------------------------------------------------

SNIPPETS = [body for language, body in FENCE.findall(STUDY_FILE) if language == "toml"]


def tables(text: str) -> dict[str, dict[str, str]]:
    """Lines of a TOML text by header and key; what stands before the first header goes by ''."""
    found: dict[str, dict[str, str]] = {"": {}}
    header = ""
    for line in text.splitlines():
        if line.startswith("["):
            header = line
            found[header] = {}
        elif line.strip():
            found[header][line.split("=")[0].strip()] = line
    return found


def completed(snippet: str) -> str:
    """A snippet as a study: whole ones as they are, fragments put into the base scene."""
    if {"[sphere]", "[inputs]"} & tables(snippet).keys():
        return snippet
    base, parts = tables(BASE), tables(snippet)
    bare = parts.pop("")
    for header, kind in (("[sphere]", SphereTable), ("[limits.crushing]", LimitTable)):
        if bare and bare.keys() <= declared(kind).keys():
            base[header].update(bare)
            bare = {}
    assert not bare, f"no table takes {', '.join(bare)}"
    whole = {**base, **parts}
    return "\n".join("\n".join([header, *lines.values()]) for header, lines in whole.items()) + "\n"


@pytest.mark.parametrize("snippet", SNIPPETS, ids=lambda text: text.splitlines()[0])
def test_every_snippet_is_a_study(snippet: str, tmp_path: Path) -> None:
    tomllib.loads(snippet)
    strengths = 4.0 + 0.3 * np.sin(np.arange(40.0))
    rows = [f"{value:.6f},{2.0 * value:.6f},16,{k % 10 == 9:d},16,{value:.6f},1" for k, value in enumerate(strengths)]
    header = "strength,F,D,stopped,diameter_mm,energy_J_kg,outcome"
    (tmp_path / "tests.csv").write_text("\n".join([header, *rows]) + "\n")
    path = tmp_path / "study.toml"
    path.write_text(completed(snippet), encoding="utf-8")
    study = load_study(path)
    assert all(line in study.text for line in snippet.splitlines())


# --- keys, laws, units, quantities ----------------------------------------------------------------


def test_tables_of_keys_are_those_of_the_declarations() -> None:
    """``python -m uqsphere.study.reference docs/study-file.md`` writes them."""
    assert with_tables(STUDY_FILE) == STUDY_FILE


def test_pulse_shapes_take_the_keys_that_are_told() -> None:
    from uqsphere.study.scene import PULSE_KEYS

    told = {ticked(row[0])[0].strip('"'): sorted(ticked(row[1])) for row in rows(section(STUDY_FILE, "## [pulse]"))}
    assert told == {shape: sorted([*needed, *more]) for shape, (needed, more) in PULSE_KEYS.items()}
    assert {key for keys in told.values() for key in keys} | {"shape", "preset"} == declared(PulseTable).keys()


def test_every_distribution_is_told_with_its_parameters() -> None:
    told: dict[str, set[str]] = {}
    bounded = set()
    for names, parameters, bounds in rows(section(STUDY_FILE, "### Distributions")):
        for name in ticked(names):
            told[name] = {word.split(" ")[0] for word in ticked(parameters)}
            bounded |= {name} if "required" in bounds else set()
    assert told.keys() == FAMILIES.keys()
    for name, law in FAMILIES.items():
        expected = {"file", "column", "unit", "fit"} if name == "empirical" else set(law.keys) - {"cov"}
        assert told[name] == expected - {"lower", "upper"}, name
        assert (name in bounded) == law.bounded, name


def test_the_table_of_units_is_that_of_the_parser() -> None:
    told = {row[0].replace("energy per mass", "specific energy").replace(" ", "_"): ticked(row[1])
            for row in rows(section(STUDY_FILE, "## Numbers").split("###")[0])}  # fmt: skip
    plain = {dimension: [unit for unit in units_of(dimension) if unit.isascii() and "^" not in unit]
             for dimension in UNITS if dimension != "number"}  # fmt: skip
    assert told == plain


def test_the_table_of_quantities_is_the_nomenclature() -> None:
    told = {name: row[2] for row in rows(section(THEORY, "## 8")) for name in ticked(row[0])}
    assert told == {name: entry.unit or "–" for name, entry in OUTPUTS.items()}


def test_symbols_have_the_units_of_the_nomenclature() -> None:
    units = {entry.symbol: entry.unit for entry in INPUTS.values()}
    seen = set()
    for names, _, given in rows(section(THEORY, "## 1")):
        symbols = [name.strip() for name in ticked(names)[0].split("=")[0].split(",")]
        told = [unit.strip().replace("³", "3").replace("–", "") for unit in given.split(",")]
        for symbol, unit in zip(symbols, told * (len(symbols) // len(told)), strict=True):
            if symbol in units:
                assert unit == units[symbol], symbol
                seen.add(symbol)
    assert {"E", "nu", "rho", "r", "E_b", "nu_b", "rho_b", "d_b", "l_0", "l_1", "l_3", "v_0"} <= seen


def test_validity_checks_have_the_thresholds_that_are_told() -> None:
    told = [(ticked(row[0])[0], row[2:]) for row in rows(section(THEORY, "## 9"))]
    assert [name for name, _ in told] == [rule.name for rule in RULES]
    for rule, (_, thresholds) in zip(RULES, told, strict=True):
        sign = "" if rule.rising else "< "
        limits = (rule.information, rule.warning, rule.failure)
        assert thresholds == ["–" if limit is None else f"{sign}{limit:g}" for limit in limits], rule.name


# --- commands -------------------------------------------------------------------------------------


#: commands that take `--set`
SETTABLE = ("check", "run", "history", "plan", "fit", "plan-tests", "feed", "records")


def parsers() -> dict[str, argparse.ArgumentParser]:
    found = next(a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction))
    return dict(found.choices)


def test_commands_and_their_options_are_those_of_the_parser() -> None:
    text = section(STUDY_FILE, "## Commands")
    told = {ticked(row[0])[0].split()[1]: " ".join(row) for row in rows(text)}
    assert told.keys() == parsers().keys()
    for name, parser in parsers().items():
        options = set(re.findall(r"(?<![\w-])--?[a-z]+(?:-[a-z]+)*", told[name]))
        options |= {"--set"} if name in SETTABLE else set()
        options |= {"--json"}
        known = [set(action.option_strings) for action in parser._actions if action.option_strings]
        assert options <= set().union(*known), name
        silent = [names for names in known if not names & (options | {"-h"})]
        assert not silent, (name, silent)


def test_every_command_named_anywhere_exists() -> None:
    for page, text in PAGES.items():
        for name in re.findall(r"(?:`|^\$ |bin/)uqsphere ([a-z][\w-]*)", text, re.MULTILINE):
            assert name in parsers(), (page, name)


def test_exit_codes_are_those_of_the_errors() -> None:
    text = section(STUDY_FILE, "## Commands").replace("\n", " ")
    told = dict(re.findall(r"\b(\d) ([a-z][^,.]*)", text[text.index("Exit codes") :]))
    family = [getattr(errors, name) for name in errors.__all__ if name.endswith(("Error", "Failures"))]
    assert {str(kind.exit_code) for kind in family} | {"0", str(MISSED)} == told.keys()
    assert "target" in told[str(MISSED)]
    assert "failed" in told[str(errors.TooManyFailures.exit_code)]
    assert "folder" in told[str(errors.FolderError.exit_code)]


# --- links, files, equations ----------------------------------------------------------------------


def anchor(heading: str) -> str:
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


@pytest.mark.parametrize("page", PAGES)
def test_every_link_leads_somewhere(page: str) -> None:
    for target in re.findall(r"\]\(([^)]+)\)", prose(PAGES[page])):
        if target.startswith("http"):
            continue
        name, _, place = target.partition("#")
        path = (ROOT / page).parent / name if name else ROOT / page
        assert path.exists(), target
        if place:
            headings = re.findall(r"^#+ (.+)$", path.read_text("utf-8"), re.MULTILINE)
            assert place in map(anchor, headings), target


@pytest.mark.parametrize("page", PAGES)
def test_every_file_named_exists_or_is_written(page: str) -> None:
    made = set(re.findall(r"-o (\S+)", PAGES[page])) | {"ishigami.py"}
    code = "\n".join(text for name, text in SOURCES.items() if name.startswith("uqsphere/"))
    named = [word for text in ticked(prose(PAGES[page])) for word in re.findall(r"[\w/.-]+", text)]
    for word in named:
        if not re.search(r"\w\.(py|md|toml|json|csv|npy|html|svg|txt)$", word) or word.startswith("FILE"):
            continue
        there = any((place / word).exists() for place in (ROOT, ROOT / "uqsphere", ROOT / "docs", ROOT / "studies"))
        there = there or any(ROOT.glob(f"uqsphere/*/**/{word}"))
        written = f'"{Path(word).name}"' in code or Path(word).stem.isupper() or Path(word).name in made
        figure = Path(word).suffix == ".svg" and Path(word).stem.split("-")[0] in code
        assert there or written or figure, (page, word)


def test_folders_named_in_the_architecture_exist() -> None:
    for word in ticked(prose(ARCHITECTURE)):
        if re.fullmatch(r"[a-z]+/", word):
            written = f'"{word[:-1]}"' in "".join(SOURCES.values())
            assert (ROOT / "uqsphere" / word).is_dir() or written, word


def test_the_order_of_imports_is_that_of_the_floors() -> None:
    line = next(line for line in ARCHITECTURE.splitlines() if line.startswith("    errors "))
    floors = {}
    for floor, names in enumerate(line.strip().split(" → ")):
        floors.update({f"uqsphere.{name}": floor for name in names.split(" | ")})
    order = sorted(set(FLOORS.values()))
    assert floors == {room: order.index(floor) for room, floor in FLOORS.items()}
    table = {name.removesuffix("/").removesuffix(".py") for row in rows(ARCHITECTURE) for name in ticked(row[0])}
    assert {room.removeprefix("uqsphere.") for room in FLOORS} == table - {"materials.toml"}


def equations() -> list[int]:
    """Numbers at the ends of lines of the fenced blocks of theory.md, in order."""
    return [int(n) for _, body in FENCE.findall(THEORY) for n in re.findall(r" \((\d+)\)$", body, re.MULTILINE)]


def cited(text: str) -> set[int]:
    chains = re.findall(r"[Tt]heory(?: \(\d+\)(?:,| and| to)?)+", text)
    return {int(n) for chain in chains for n in re.findall(r"\((\d+)\)", chain)}


def test_equations_are_numbered_in_order() -> None:
    assert equations() == list(range(1, len(equations()) + 1))


def test_every_equation_and_section_cited_exists() -> None:
    sections = set(re.findall(r"^## (\d+) ", THEORY, re.MULTILINE))
    assert cited("theory (4) and (5), theory (99)") == {4, 5, 99}
    found = 0
    for name, text in {**SOURCES, **PAGES}.items():
        if name == "tests/test_docs.py":
            continue
        assert cited(text) <= set(equations()), name
        assert set(re.findall(r"[Tt]heory section (\d+)", text)) <= sections, name
        found += len(cited(text))
    assert found > 20
    assert {int(n) for n in re.findall(r"\((\d{1,2})\)", prose(THEORY))} <= set(equations())


def test_what_section_5_is_cited_for_stands_there() -> None:
    assert "`1.318 mu^0.45`" in section(THEORY, "## 5")
    assert (ROOT / "uqsphere/mechanics/validity.py").read_text("utf-8").count("(1.318, 0.45)") == 1


# --- numbers --------------------------------------------------------------------------------------


def test_sizes_in_the_text_are_those_of_the_code() -> None:
    flat = re.sub(r"\s+", " ", THEORY)
    for text in (
        f"pilot sample of {schedule.PILOT.first} rows",
        f"first {schedule.PILOT.first // 2} with the cheaper ones",
        f"`R = {schedule.REPLICATES}` independent",
        f"at most {schedule.SAMPLING.share:.0%} of".replace("%", " %"),
        f"more than {schedule.CAUTION:g} times what",
        f"at least {stopping.SLOWEST:g}, at most {stopping.FASTEST:g}",
        f"from {schedule.SAMPLING.judged} points of each scrambling (indices: {schedule.INDICES.judged} base points)",
        f"total index (28) puts above {indices.LARGE:g} are taken from (29)",
        f"half-width is above {indices.WORTHLESS:g} is withheld",
        f"up to {sensitivity.FIT_POINTS} points of each of {sensitivity.FITS} scramblings",
    ):
        assert text in flat, text
    from uqsphere.mechanics.integrator.incoming import WAVE
    from uqsphere.mechanics.integrator.step import ORDER

    assert f"Taylor series of order {ORDER}" in flat
    assert f"at {WAVE} Chebyshev points" in flat


def scene(count: int = 1, **changed: Any) -> dict[str, Any]:
    """Columns of the example of theory section 3, `count` rows."""
    values = {**ENDLESS, **changed}
    return {name: np.broadcast_to(np.asarray(value, dtype=float), (count,)) for name, value in values.items()}


def test_the_example_comes_out() -> None:
    ends: dict[str, Any] = {"bars.incident_length": 1.5, "bars.receiving_length": 1.5, "bars.incident_end": 1.0,
                            "bars.receiving_end": 1.0}  # fmt: skip
    found = dynamics.solve(Scene(columns=scene(**ends)), tolerance=1e-9).values
    pressure, first, time = (float(found[name][0]) for name in ("p_max", "first_peak", "contact_time"))
    assert f"{pressure / 1e9:.8f} GPa and {time * 1e3:.8f} ms" in ERRATA
    example = re.sub(r"\s+", " ", THEORY)
    assert f"the first loading reaches {first / 1e9:.4f} GPa, the second {pressure / 1e9:.4f} GPa" in example
    assert f"after {time * 1e3:.4f} ms" in example


def test_what_a_step_does_at_several_masses() -> None:
    mu = np.array([10.0, 1.0, 0.1, 0.01, 0.001])
    unit = Scene(columns=scene(), infinite=True).scales
    density = 2650.0 * mu / unit.mass_number[0]
    steps = Scene(columns=scene(len(mu), **{"sphere.density": density}), shape="step", infinite=True,
                  horizon=100.0 * float(unit.time[0]))  # fmt: skip
    found = dynamics.solve(steps, tolerance=1e-8, quantities=("P_max", "force_imbalance"))
    assert not found.status.any()
    peaks = found.values["P_max"] / steps.scales.force
    assert ", ".join(f"{peak:.4f}" for peak in peaks[:4]) + " at `mu` = 10, 1, 0.1, 0.01" in ERRATA
    apart = found.values["force_imbalance"] * peaks
    told = re.sub(r"\s+", " ", THEORY)
    assert ", ".join(f"{difference:.3g}" for difference in apart[2:]) + " of `P_0` at `mu` = 0.1, 0.01, 0.001" in told
    assert apart[4] == pytest.approx(1.318 * 0.001**0.45, rel=2e-3)


def test_numbers_of_the_massless_sphere() -> None:
    literal, _ = quad(lambda x: 1.0 / (1.0 - 0.5 * x**3), 0.0, 1.0)
    assert f"it is {4.0 * literal:.3f};" in ERRATA
    share = brentq(lambda x: 4.0 * float(loading_time(x)) - as_printed.DURATION_FACTOR, 0.5, 0.99)
    assert f"{as_printed.DURATION_FACTOR} is twice the time to `x = {share:.4f}`" in ERRATA
    after = float(massless_approach(6.0, 0.8))
    start = float(massless_approach(0.8, 0.8))
    assert f"{after:.7f} at `s = 6`" in ERRATA
    assert f"without the 1/2 it is {float(relaxing_approach(start, 2.0 * 5.2)):.7f}" in ERRATA
    levels = np.array([0.5, 0.9, 0.95, 0.99]) ** (2.0 / 3.0)
    assert "`s` = " + ", ".join(f"{s:.4f}" for s in loading_time(levels)) in THEORY


def test_numbers_of_the_linear_sphere() -> None:
    """(4.9) as printed lacks the decay of the swing: beta = Z = v0 = 1, M = 0.3, so that L = 1, s = t, mu = 0.3."""
    frequency = math.sqrt(2.0 / 0.3 - 0.25)
    assert f"in the end by {0.5 / frequency:.3f} to either side of 0.5" in ERRATA
    t = np.linspace(20.0, 30.0, 2001)
    printed = 0.5 * (1.0 - np.exp(-t) + np.sin(frequency * t) / frequency)
    right = 0.5 * (np.asarray(linear_approaches(t, 0.3)[0]))
    assert np.abs(right - 0.5).max() < 1e-4
    assert np.abs(printed - right).max() == pytest.approx(0.5 / frequency, rel=1e-3)


def test_numbers_of_the_free_impact() -> None:
    assert f"1.25^0.6 = {1.25**0.6:.7f}" in ERRATA
    duration = 2.0 * math.sqrt(math.pi) * gamma(1.4) / gamma(0.9)
    assert f"= {duration:.7f} alpha_m/v" in ERRATA
    integral, _ = quad(lambda u: 2.0 * u * 2.0 / math.sqrt(1.0 - (1.0 - u * u) ** 2.5), 0.0, 1.0)
    assert integral == pytest.approx(duration, rel=1e-9)


def test_numbers_of_the_tension_at_the_centre() -> None:
    values = [float(centre_tension(1.0, 0.5, nu)) for nu in (0.1, 0.2, 0.25, 0.3)]
    assert "it is " + ", ".join(f"{value:.3f}" for value in values) + " times `P/D²`" in re.sub(r"\s+", " ", THEORY)


def test_commands_are_executed_or_said_not_to_be() -> None:
    """Console blocks stand in pages whose tests run them; any other block of commands or Python gives a reason."""
    run_elsewhere = {"README.md", "docs/borehole.md", *(name for name in PAGES if "tutorial-" in name)}
    for name, page in PAGES.items():
        if name in run_elsewhere:
            continue
        for after in re.findall(r"^```(?:sh|console|python)\n.*?^```\n\n(.*?)$", page, re.DOTALL | re.MULTILINE):
            assert after.startswith("(Not run by the tests: "), f"{name}: {after[:60]}"


# --- the site, and how to cite -------------------------------------------------------------------------------


def test_the_site_has_every_page_and_the_public_names(tmp_path: Path) -> None:
    build = pytest.importorskip("sphinx.cmd.build")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert build.main(["-q", "-W", str(ROOT / "docs"), str(tmp_path)]) == 0
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")}
    assert pages <= {path.stem for path in tmp_path.glob("*.html")}
    reference = (tmp_path / "api.html").read_text("utf-8")
    for name in uqsphere.__all__:
        assert re.search(rf'id="(module-)?uqsphere\.{name}"', reference), name
    for page in pages - {"index"}:
        assert f'href="{page}.html"' in (tmp_path / "index.html").read_text("utf-8")


def test_what_is_cited_is_this_version() -> None:
    cited = dict(re.findall(r"^([\w-]+): (.+)$", (ROOT / "CITATION.cff").read_text("utf-8"), re.MULTILINE))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert (cited["version"], cited["license"], cited["cff-version"]) == (
        project["version"],
        project["license"],
        "1.2.0",
    )
