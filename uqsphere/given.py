"""What a table of runs that were made already can tell: laws of the inputs, dependence, outputs, what drives them."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.console import table
from uqsphere.errors import AccessError, UsageError
from uqsphere.quantities import format_estimate
from uqsphere.uq.estimates import Estimate, absent
from uqsphere.uq.laws import Law

__all__ = ["Data", "analyse_data", "analysis_text", "read_data", "study_text"]

Array = npt.NDArray[np.float64]

SCHEMA_VERSION: Final = 1
#: bytes of a file, and rows and columns that are looked at
_LARGEST: Final = 256 * 1024 * 1024
_MOST_COLUMNS: Final = 100
#: rows that an expansion is fitted to: beyond, it gains nothing
_MOST_FITTED: Final = 2000
_FOLDS: Final = 5
#: a law that so few samples of its own would lie as far from is doubted
_DOUBT: Final = 0.01
_LAWS: Final = 400
_QUANTILES: Final = (0.05, 0.5, 0.95)


@dataclass(frozen=True, kw_only=True, eq=False)
class Data:
    """Named columns of one table: inputs (n, d) and outputs (n, q)."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    x: Array
    y: Array


def read_data(path: Path, inputs: Sequence[str], outputs: Sequence[str]) -> Data:
    """Columns of a CSV with a header line.

    Raises
    ------
    AccessError
        When the file cannot be read.
    UsageError
        For columns that are missing, named twice or hold what is no finite number, with the line.
    """
    names = [*inputs, *outputs]
    if not inputs or not outputs:
        raise UsageError("name at least one input and one output: --inputs a,b --outputs y")
    if len(set(names)) != len(names):
        raise UsageError(f"a column is named twice among {', '.join(names)}")
    if len(names) > _MOST_COLUMNS:
        raise UsageError(f"found {len(names)} columns, at most {_MOST_COLUMNS} are analysed at a time")
    header, rows = _lines(path)
    places = []
    for name in names:
        if header.count(name) != 1:
            said = "twice or more" if name in header else "not"
            raise UsageError(f"{path}: the column {name!r} is {said} there; columns: {', '.join(header[:30])}")
        places.append(header.index(name))
    values = np.empty((len(rows), len(names)))
    for k, (line, row) in enumerate(rows):
        for column, place in enumerate(places):
            cell = row[place] if place < len(row) else ""
            try:
                values[k, column] = float(cell)
            except ValueError:
                values[k, column] = math.nan
            if not math.isfinite(values[k, column]):
                raise UsageError(
                    f"{path}:{line}: column {names[column]!r}: found {cell[:40]!r}, where a finite number is due"
                )
    if len(values) < 5:
        raise UsageError(f"{path}: found {len(values)} rows, at least 5 are needed")
    d = len(inputs)
    return Data(inputs=tuple(inputs), outputs=tuple(outputs), x=values[:, :d], y=values[:, d:])


def _lines(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    try:
        if path.stat().st_size > _LARGEST:
            raise UsageError(f"{path} is larger than {_LARGEST // 1024**2} MiB: thin it out first")
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise AccessError(f"{path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path} is not UTF-8 text") from error
    try:
        reader = csv.reader(io.StringIO(text, newline=""), strict=True)
        rows = [(reader.line_num, [c.strip() for c in row]) for row in reader if any(c.strip() for c in row)]
    except csv.Error as error:
        raise UsageError(f"{path} is no CSV: {error}") from error
    if not rows:
        raise UsageError(f"{path} is empty")
    header = rows[0][1]
    if len(header) == 1 and header[0].count(";"):
        raise UsageError(f"{path} is divided by semicolons: commas between columns and points in numbers are due")
    return header, rows[1:]


# --- the analysis -----------------------------------------------------------------------------------


def analyse_data(data: Data, *, seed: int = 0) -> dict[str, Any]:
    """Everything that the table tells, ready for JSON: marginal laws with their fit and what it leaves open, rank
    correlations, distributions of the outputs, first-order indices by ranks, and indices of a polynomial chaos."""
    from uqsphere.uq.marginals import rank_correlations, tied
    from uqsphere.uq.sampling import random_generator

    marginals, laws = {}, []
    for k, name in enumerate(data.inputs):
        entry, law = _marginal(data.x[:, k], random_generator(seed=seed, task=f"analyse {name}"))
        marginals[name] = entry
        laws.append(law)
    pairs = rank_correlations(data.x) if len(data.inputs) > 1 else []
    clear = {(i, j) for i, j, _ in tied(pairs)}
    dependence = [
        {"of": [data.inputs[i], data.inputs[j]], "spearman": e.as_dict(), "dependent": (i, j) in clear}
        for i, j, e in pairs
    ]
    sensitivity = {}
    for k, name in enumerate(data.outputs):
        generator = random_generator(seed=seed, task=f"analyse ranks {name}")
        sensitivity[name] = _drivers(data, k, laws, bool(clear), generator)
    return {
        "schema_version": SCHEMA_VERSION,
        "rows": len(data.x),
        "inputs": marginals,
        "dependence": dependence,
        "outputs": {name: _output(data.y[:, k]) for k, name in enumerate(data.outputs)},
        "sensitivity": sensitivity,
    }


def _marginal(values: Array, generator: np.random.Generator) -> tuple[dict[str, Any], Law | None]:
    """One input: every law that was tried, which is taken, and what the observations leave open of it."""
    from uqsphere.uq.distribution import mean, sd
    from uqsphere.uq.ignorance import possible_laws
    from uqsphere.uq.laws import make_law
    from uqsphere.uq.marginals import fit_marginal

    try:
        fits = fit_marginal(values, generator)
    except ValueError as error:
        return {"chosen": None, "reason": str(error), "fits": []}, None
    best = fits[0]
    entry: dict[str, Any] = {
        "chosen": best.law.kind,
        "parameters": dict(best.law.parameters),
        "fits": [
            {
                "dist": f.law.kind,
                "criterion": f.criterion - best.criterion,
                "distance": f.distance,
                "p_value": f.p_value,
            }
            for f in fits
        ],
        "reason": None,
    }
    law = best.law
    if best.p_value < _DOUBT:
        law = make_law("empirical", {}, data=values[:5000].tolist(), fit="kde")
        entry["chosen"] = "kde"
        entry["parameters"] = dict(law.parameters)
        entry["reason"] = f"no family fits: even the best, {best.law.kind}, has a p-value of {best.p_value:.2g}"
    entry["mean"], entry["sd"] = mean(law), sd(law)
    if law.kind != "empirical":
        others = possible_laws(law, _LAWS, generator)
        for what, of in (("mean", mean), ("sd", sd)):
            found = np.array([of(other) for other in others])
            low, high = np.quantile(found[np.isfinite(found)], [0.025, 0.975])
            entry[f"{what}_left_open"] = [float(low), float(high)]
    return entry, law


def _output(values: Array) -> dict[str, Any]:
    """Mean, standard deviation and quantiles of independent runs."""
    from uqsphere.uq.estimates import student
    from uqsphere.uq.marginals import quantile_interval

    n = values.size
    centre, spread = float(values.mean()), float(values.std(ddof=1))
    half = student(n) * spread / math.sqrt(n)
    kurtosis = float(((values - centre) ** 4).mean() / max(float(values.var()) ** 2, 1e-300))
    error = math.sqrt(max(kurtosis - (n - 3.0) / (n - 1.0), 0.0) / n) / 2.0
    quantiles = {}
    for p in _QUANTILES:
        found = quantile_interval(values, p)
        reason = f"{n} runs are too few for an interval of the {p:g} quantile"
        quantiles[f"{p:g}"] = (found or absent(reason, "order statistics", n)).as_dict()
    return {
        "mean": Estimate(value=centre, low=centre - half, high=centre + half, std_error=spread / math.sqrt(n),
                         method="independent runs", evaluations=n).as_dict(),
        "sd": Estimate(value=spread, low=spread * math.exp(-1.96 * error), high=spread * math.exp(1.96 * error),
                       std_error=spread * error, method="independent runs", evaluations=n).as_dict(),
        "quantiles": quantiles,
    }  # fmt: skip


def _drivers(
    data: Data, column: int, laws: Sequence[Law | None], dependent: bool, generator: np.random.Generator
) -> dict[str, Any]:
    """First-order indices by ranks; first and total ones by polynomial chaos where it may be used."""
    from uqsphere.uq.ranks import rank_indices

    ranks = rank_indices(data.x, data.y[:, column], generator)
    answer: dict[str, Any] = {"ranks": {n: e.as_dict() for n, e in zip(data.inputs, ranks, strict=True)}}
    if dependent:
        reason = "inputs depend on each other: its indices would not share out the variance"
    elif any(law is None for law in laws):
        reason = "an input has no law"
    else:
        return {**answer, "chaos": _expansion(data, column, [law for law in laws if law is not None], generator)}
    return {**answer, "chaos": {"usable": False, "reason": reason}}


def _expansion(data: Data, column: int, laws: Sequence[Law], generator: np.random.Generator) -> dict[str, Any]:
    from scipy.special import ndtri

    from uqsphere.uq.chaos import chaos_indices, fit_chaos, germ_points, judge, validation_error
    from uqsphere.uq.distribution import cdf, sf

    rows = generator.permutation(len(data.x))[:_MOST_FITTED]
    y = data.y[rows, column]
    scores = np.empty((len(rows), len(laws)))
    for k, law in enumerate(laws):
        below, above = cdf(law, data.x[rows, k]), sf(law, data.x[rows, k])
        scores[:, k] = np.clip(np.where(below < 0.5, ndtri(below), -ndtri(above)), -8.0, 8.0)
    germs = ("normal",) * len(laws)
    points = germ_points(scores, germs)
    if len(rows) < 4 * (len(laws) + 1):
        return {"usable": False, "reason": f"{len(rows)} runs are too few for {len(laws)} inputs"}
    fold = np.arange(len(rows)) % _FOLDS
    try:
        errors = [
            validation_error(fit_chaos(points[fold != k], y[fold != k], germs), points[fold == k], y[fold == k])
            for k in range(_FOLDS)
        ]
        fitted = fit_chaos(points, y, germs)
    except ValueError as refusal:
        return {"usable": False, "reason": str(refusal)}
    verdict = judge(fitted, float(np.mean(errors)), most=0.2)
    about: dict[str, Any] = {"usable": verdict.usable, "error": verdict.error, "reason": verdict.reason}
    if not verdict.usable:
        return about
    indices = chaos_indices([fitted], error=verdict.error, evaluations=len(rows))
    for order, found in indices.items():
        about[order] = {name: e.as_dict() for name, e in zip(data.inputs, found, strict=True)}
    return about


# --- for people ---------------------------------------------------------------------------------------


def _shown(estimate: Mapping[str, Any]) -> str:
    if estimate["value"] is None:
        return f"- ({estimate['reason']})"
    return format_estimate(estimate["value"], estimate["low"], estimate["high"])


def _range(ends: Sequence[float] | None) -> str:
    return f"{ends[0]:.4g} to {ends[1]:.4g}" if ends else "-"


def analysis_text(found: Mapping[str, Any]) -> str:
    """The analysis for the terminal."""
    parts = [f"{found['rows']:,} rows", ""]
    rows: list[tuple[str, ...]] = []
    for name, entry in found["inputs"].items():
        if entry["chosen"] is None:
            rows.append((name, "-", entry["reason"], "", "", "", ""))
            continue
        centre, spread = f"{entry['mean']:.5g}", f"{entry['sd']:.4g}"
        opened = [_range(entry.get(f"{what}_left_open")) for what in ("mean", "sd")]
        judged = f"{entry['fits'][0]['p_value']:.2g}"
        rows.append((name, entry["chosen"], judged, centre, opened[0], spread, opened[1]))
    header = ("input", "law", "fit (p)", "mean", "left open (95 %)", "sd: scatter", "left open (95 %)")
    parts += [table(header, rows), ""]
    parts += [f"{name}: {entry['reason']}" for name, entry in found["inputs"].items() if entry["reason"]]
    tied = [pair for pair in found["dependence"] if pair["dependent"]]
    for pair in tied:
        parts.append(f"{' and '.join(pair['of'])} depend on each other: rank correlation {_shown(pair['spearman'])}")
    if not tied and found["dependence"]:
        parts.append("no two inputs depend on each other beyond chance")
    rows = []
    for name, entry in found["outputs"].items():
        rows += [(name, "mean", _shown(entry["mean"])), ("", "standard deviation", _shown(entry["sd"]))]
        rows += [("", f"{100.0 * float(p):g} % quantile", _shown(e)) for p, e in entry["quantiles"].items()]
    parts += ["", table(("output", "statistic", "value (95 % interval)"), rows), ""]
    rows = []
    for name, entry in found["sensitivity"].items():
        chaos = entry["chaos"]
        for k, (source, estimate) in enumerate(entry["ranks"].items()):
            total = _shown(chaos["total"][source]) if chaos["usable"] else "-"
            first = _shown(chaos["first"][source]) if chaos["usable"] else "-"
            rows.append((name if k == 0 else "", source, _shown(estimate), first, total))
    parts.append(table(("output", "input", "first, by ranks", "first, by chaos", "total, by chaos"), rows))
    for name, entry in found["sensitivity"].items():
        parts.append(f"{name}: polynomial chaos: {entry['chaos']['reason']}")
    return "\n".join(parts)


def study_text(found: Mapping[str, Any]) -> str:
    """The inputs as a black-box study would have them, to go on with."""
    lines = [
        "# laws fitted to given data; a study with these inputs runs with --model FILE.py:FUNCTION",
        "",
        "[inputs]",
    ]
    for name, entry in found["inputs"].items():
        if entry["chosen"] in (None, "kde"):
            lines.append(f"# {name}: {entry['reason']}; give it as an empirical law with its own CSV")
            continue
        keys = ", ".join(f"{key} = {value!r}" for key, value in entry["parameters"].items())
        lines.append(f'{_key(name)} = {{ dist = "{entry["chosen"]}", {keys} }}')
    for pair in found["dependence"]:
        if pair["dependent"]:
            names = ", ".join(_quoted(name) for name in pair["of"])
            lines += ["", "[[dependence]]", f"of = [{names}]", f"spearman = {pair['spearman']['value']:.4f}"]
    lines += ["", "[outputs]", f"names = [{', '.join(_quoted(name) for name in found['outputs'])}]"]
    return "\n".join(lines) + "\n"


def _quoted(name: str) -> str:
    escaped = name.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _key(name: str) -> str:
    bare = name.replace("-", "_")
    return name if bare.isascii() and bare.replace("_", "a").isalnum() else _quoted(name)
