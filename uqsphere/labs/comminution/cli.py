"""`uqsphere comminution fit | feed`."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from uqsphere.documents import load_document
from uqsphere.labs.comminution.document import ComminutionDocument
from uqsphere.labs.files import csv_text, finish, table


def main(argv: Sequence[str]) -> int:
    """Run a command of the lab."""
    parser = argparse.ArgumentParser(prog="uqsphere comminution", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    for name, text in (
        (
            "fit",
            (
                "posterior of the fracture energy from tests of single particles; draws.csv is a "
                "strength"
            ),
        ),
        ("feed", "what becomes of a feed under blows"),
    ):
        one = commands.add_parser(name, help=text, description=text)
        one.add_argument("file", type=Path, help="input file (TOML)")
        one.add_argument(
            "--out", type=Path, help="folder for the files (default: FILE-fit, FILE-feed)"
        )
        one.add_argument("--json", action="store_true", help="one JSON document on stdout")
    _run(parser.parse_args(argv))
    return 0


def _run(chosen: argparse.Namespace) -> None:
    from uqsphere.labs.comminution.feed import answer_feed
    from uqsphere.labs.comminution.fit import UNTESTED, fit
    from uqsphere.labs.comminution.tests import load_tests

    asked = load_document(chosen.file, ComminutionDocument)
    folder = chosen.file.parent
    fitted = fit(load_tests(asked, folder), asked)
    low, high = fitted.posterior.tested
    at = asked.strength_at or math.sqrt(low * high)
    content = {**fitted.content, "strength_at": at}
    files = {"draws.csv": fitted.posterior.strength_csv(at), "fit.json": _json(content)}
    text, warnings = _fit_text(content), [*fitted.content["warnings"]]
    if at < low / UNTESTED or at > high * UNTESTED:
        law = "" if fitted.content["size"] == "class" else f" by the size law {content['size']!r}"
        warnings.append(
            f"strength_at = {at * 1e3:.4g} mm is outside the tested sizes ({low * 1e3:.4g} to "
            f"{high * 1e3:.4g} mm): draws.csv is an extrapolation{law}. Test this size"
        )
    if chosen.command == "feed":
        answer = answer_feed(fitted.posterior, asked, folder)
        classes = [
            (c["upper"], c["size"], c["mass"], *c["broken"].values())
            for c in answer.content["classes"]
        ]
        head = ["upper [m]", "size [m]", "mass", "broken", "low", "high"]
        files |= {
            "feed.json": _json(answer.content),
            "classes.csv": csv_text(head, [*zip(*classes, strict=True)]),
        }
        if product := [tuple(one.values()) for one in answer.content["product"]]:
            head = ["sieve [m]", "feed", "passing", "low", "high"]
            files["product.csv"] = csv_text(head, [*zip(*product, strict=True)])
        content, text = {"fit": content, "feed": answer.content}, _feed_text(answer.content)
        warnings = [*warnings, *answer.content["warnings"]]
    for warning in dict.fromkeys(warnings):
        print(f"note: {warning}", file=sys.stderr)
    finish(chosen, content, text, files, Path(f"{chosen.file.stem}-{chosen.command}"))


def _json(content: Any) -> str:
    return json.dumps(content, indent=1, allow_nan=False, default=float) + "\n"


def _interval(one: dict[str, float], factor: float = 1.0, unit: str = "") -> tuple[str, str]:
    low, high = one["low"] * factor, one["high"] * factor
    return f"{one['value'] * factor:.4g} {unit}".rstrip(), f"{low:.4g} to {high:.4g}"


def _fit_text(content: dict[str, Any]) -> str:
    tests = content["tests"]
    head = f"{content['title'] or 'tests'}: {tests['particles']} particles, {tests['broke']} broke"
    rows = [
        ("size", "tests", "E50 of the law", "95 %", "breaks half", "95 %", "breaks 1 %", "95 %")
    ]
    for one in content["sizes"]:
        energies = [
            _interval(one[key], 1.0, "J/kg") for key in ("E50", "breaks_half", "breaks_1_percent")
        ]
        rows.append((f"{one['diameter'] * 1e3:.4g} mm", str(one["tests"]), *sum(energies, ())))
    laws = [("law", "weight", "log likelihood", "log score (leave one out)")]
    laws += [
        (law, f"{one['weight']:.0%}", f"{one['log_likelihood']:.2f}", f"{one['loo']:.2f}")
        for law, one in content["laws"].items()
    ]
    names = [("parameter", "value", "95 %", "sd of the logarithm: prior, posterior")]
    for name, one in content["parameters"].items():
        prior = "flat" if one["prior_sd"] is None else f"{one['prior_sd']:.2g}"
        names.append((name, *_interval(one), f"{prior}, {one['sd']:.2g}"))
    use = (
        f'strength = {{ draws = "draws.csv" }}    # of particles of '
        f"{content['strength_at'] * 1e3:.4g} mm, J/kg"
    )
    return "\n\n".join([head, table(rows), table(laws), table(names), use])


def _feed_text(content: dict[str, Any]) -> str:
    scale = {
        "energy [J/kg]": ("energy of the particles", 1.0 / 3600.0, "kWh/t"),
        "P80 [m]": ("P80", 1e3, "mm"),
        "P50 [m]": ("P50", 1e3, "mm"),
    }
    rows = [("answer", "value", "95 %")]
    for name, one in content["numbers"].items():
        words, factor, unit = scale.get(name, (name, 1.0, ""))
        if name in ("broken", "never broken", "t10", "fines"):
            factor, unit = 100.0, "%"
        rows.append((words, *_interval(one, factor, unit)))
    if "lot" in content:
        one = content["lot"]
        value, reach = _interval(one["broken"], 100.0, "%")
        spread = (
            f"{reach}; sd {100 * one['epistemic_sd']:.2g} % of the tests, "
            f"{100 * one['lot_sd']:.2g} % of the lot"
        )
        rows.append((f"broken of a lot of {one['mass']:.4g} kg", value, spread))
    classes = [("size", "mass", "broken", "95 %", "")]
    for one in content["classes"]:
        size, mark = f"{one['size'] * 1e3:.4g} mm", "extrapolated" if one["extrapolated"] else ""
        classes.append((size, f"{one['mass']:.1%}", *_interval(one["broken"], 100.0, "%"), mark))
    return "\n\n".join([content["title"] or "feed", table(rows), table(classes)])
