"""`uqsphere comminution fit | feed`."""

import json
import math
from argparse import Namespace
from pathlib import Path

from uqsphere.documents import load_document
from uqsphere.errors import UsageError, tell
from uqsphere.labs.files import JsonObject, csv_text, finish, named_by, table
from uqsphere.uq import LEVEL_TEXT

from .document import ComminutionDocument


def _run(chosen: Namespace) -> None:
    from .feed import answer_feed
    from .fit import fit
    from .tests import load_tests

    asked = load_document(chosen.file, ComminutionDocument)
    folder = chosen.file.parent
    with named_by(chosen.file, "tests", "file"):
        tests = load_tests(asked, folder)
        try:
            posterior, fitted = fit(tests, asked)
        except UsageError:
            for note in tests.notes:  # one of these rows may be the cause
                tell(f"note: {note}")
            raise
        low, high = posterior.tested
        at = asked.strength_at or math.sqrt(low * high)
        draws = posterior.strength_csv(at, synthetic=asked.tests.synthetic)
    content = {**fitted, "strength_at": at}
    files = {"draws.csv": draws, "fit.json": _json(content)}
    text = _fit_text(content)
    warnings = [*fitted["warnings"]]
    if posterior.is_untested(at):
        extrapolation = f"an extrapolation by the size law {fitted['size']!r}"
        if fitted["size"] == "class":
            extrapolation = "the strength of the nearest tested size"
        warnings.append(
            f"strength_at = {at * 1e3:.4g} mm is outside the tested sizes ({low * 1e3:.4g} to "
            f"{high * 1e3:.4g} mm): draws.csv is {extrapolation}. Test this size"
        )
    if chosen.command == "feed":
        with named_by(chosen.file, "feed", "sizes", "file"):
            answer = answer_feed(posterior, asked, folder)
        content = {"fit": content, "feed": answer}
        text = _feed_text(answer)
        warnings += answer["warnings"]
        files["feed.json"] = _json(answer)
        rows = [
            (row["upper"], row["size"], row["mass"], *row["broken"].values())
            for row in answer["classes"]
        ]
        head = ["upper [m]", "size [m]", "mass", "broken", "low", "high"]
        files["classes.csv"] = csv_text(rows, head)
        if answer["product"]:
            rows = [row.values() for row in answer["product"]]
            head = ["sieve [m]", "feed", "passing", "low", "high"]
            files["product.csv"] = csv_text(rows, head)
    for warning in dict.fromkeys(warnings):
        tell(f"note: {warning}")
    chosen.out = chosen.out or Path(f"{chosen.file.stem}-{chosen.command}")
    finish(chosen, content, text, files)


#: what each command runs, and its help
COMMANDS = {
    "fit": (
        _run,
        "fracture energy from tests of single particles; writes draws.csv, a strength "
        "(default folder: FILE-fit)",
    ),
    "feed": (
        _run,
        "shares broken, product and energy of a feed under blows (default folder: FILE-feed)",
    ),
}


def _json(content: JsonObject) -> str:
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def _interval(estimate: dict[str, float], factor: float = 1.0, unit: str = "") -> tuple[str, str]:
    ends = f"{factor * estimate['low']:.4g} to {factor * estimate['high']:.4g}"
    return f"{factor * estimate['value']:.4g} {unit}".rstrip(), ends


def _fit_text(content: JsonObject) -> str:
    tests = content["tests"]
    head = f"{content['title'] or 'tests'}: {tests['particles']} particles, {tests['broke']} broke"
    head_of_sizes = ["size", "tests", "E50 of the law", LEVEL_TEXT]
    sizes = [[*head_of_sizes, "breaks half", LEVEL_TEXT, "breaks 1 %", LEVEL_TEXT]]
    for size in content["sizes"]:
        row = [f"{size['diameter'] * 1e3:.4g} mm", str(size["tests"])]
        for key in ("E50", "breaks_half", "breaks_1_percent"):
            row += _interval(size[key], 1.0, "J/kg")
        sizes.append(row)
    laws = [("law", "weight", "log likelihood", "log score (leave one out)")]
    laws += [
        (name, f"{law['weight']:.0%}", f"{law['log_likelihood']:.2f}", f"{law['loo']:.2f}")
        for name, law in content["laws"].items()
    ]
    names = [("parameter", "value", LEVEL_TEXT, "sd of the logarithm: prior, posterior")]
    for name, parameter in content["parameters"].items():
        prior = "flat"
        if parameter["prior_sd"]:
            prior = f"{parameter['prior_sd']:.2g}"
        names.append((name, *_interval(parameter), f"{prior}, {parameter['sd']:.2g}"))
    use = (
        'In a study: strength = { draws = "draws.csv" }, specific energy of particles of '
        f"{content['strength_at'] * 1e3:.4g} mm"
    )
    return "\n\n".join([head, table(sizes), table(laws), table(names), use])


def _feed_text(content: JsonObject) -> str:
    shown = {
        "energy [J/kg]": ("energy absorbed by the particles", 1.0 / 3600.0, "kWh/t"),
        "P80 [m]": ("P80", 1e3, "mm"),
        "P50 [m]": ("P50", 1e3, "mm"),
        **{name: (name, 100.0, "%") for name in ("broken", "t10", "fines")},
    }
    rows = [("answer", "value", LEVEL_TEXT)]
    for name, number in content["numbers"].items():
        words, factor, unit = shown.get(name, (name, 1.0, ""))
        rows.append((words, *_interval(number, factor, unit)))
    if "lot" in content:
        lot = content["lot"]
        value, reach = _interval(lot["broken"], 100.0, "%")
        spread = (
            f"{reach}; sd {100 * lot['epistemic_sd']:.2g} % from the tests, "
            f"{100 * lot['lot_sd']:.2g} % from the lot"
        )
        rows.append((f"broken in a lot of {lot['mass']:.4g} kg", value, spread))
    classes = [("size", "mass", "broken", LEVEL_TEXT, "remark")]
    for row in content["classes"]:
        mark = ""
        if row["extrapolated"]:
            mark = "extrapolated"
        broken = _interval(row["broken"], 100.0, "%")
        classes.append((f"{row['size'] * 1e3:.4g} mm", f"{row['mass']:.1%}", *broken, mark))
    return "\n\n".join([content["title"] or "feed", table(rows), table(classes)])
