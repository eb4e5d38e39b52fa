"""The analysis for the terminal, and as the beginning of a study."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from uqsphere.console import screen_width, table, wrap, writable
from uqsphere.errors import told
from uqsphere.given.table import Document
from uqsphere.quantities import format_estimate
from uqsphere.study.limits import valid_name
from uqsphere.study.resolve import RESERVED

#: inputs from which on a table of all pairs, or of all fits, would say nothing to anybody
_MANY: Final = 30
#: a unit behind a name; characters of a name that is made; the largest rank correlation that is written
_UNIT: Final = re.compile(r"\s*[\[(][^\])]*[\])]\s*$")
_LONGEST: Final = 40
_STRONGEST: Final = 0.9999
#: what is called by which name
_ORDERS: Final = {"shapley": "Shapley effect", "first": "first", "total": "total"}


def _shown(estimate: Document) -> str:
    if estimate["value"] is None:
        reason = "too few runs" if "too few" in estimate["reason"] else estimate["reason"]
        return f"- ({reason})"
    return format_estimate(estimate["value"], estimate["low"], estimate["high"])


def _share(estimate: Document) -> str:
    """A share of 1: what is known beyond six decimals is of no use to anybody."""
    if estimate["value"] is None or estimate["high"] - estimate["low"] > 2e-6:
        return _shown(estimate)
    return f"{estimate['value'] + 0.0:.6f}"


def _range(ends: Sequence[float] | None) -> str:
    return f"{ends[0]:.4g} to {ends[1]:.4g}" if ends else "-"


def analysis_text(found: Document, width: int | None = None) -> str:
    """The analysis for the terminal: no line is longer than `width` columns, those of the terminal where it is None."""
    columns = screen_width() if width is None else width
    parts = [
        f"{found['rows']:,} rows",
        "",
        *_inputs(found, columns),
        *dependence_lines(found),
        "",
        _outputs(found, columns),
        "",
    ]
    parts.append(_drivers(found, columns))
    for name, entry in found["sensitivity"].items():
        chaos = entry["chaos"]
        parts += (
            ["", f"{name}: {expansion_line(found, name)}"]
            if chaos["usable"]
            else ["", f"{name}: expansion: {chaos['reason']}"]
        )
        parts += [f"{name}: {note}" for note in [*found["outputs"][name]["notes"], *chaos.get("notes", ())]]
        if entry["disagree"]:
            parts.append(
                f"{name}: WARNING: runs and expansion disagree by more than chance: {'; '.join(entry['disagree'])}. "
                "The laws, or what is said of the dependence, are wrong, or the runs were not drawn independently; "
                "believe neither before that is settled"
            )
    # a text of one line is a sentence, one of several a table
    return writable("\n".join(text if "\n" in text else wrap(text, columns) for text in parts))


def _inputs(found: Document, width: int) -> list[str]:
    rows: list[tuple[str, ...]] = []
    for name, entry in found["inputs"].items():
        if entry["chosen"] is None:
            same = entry["fixed"]
            rows.append((name, *(("-", "", "") if same is None else ("fixed", "", f"{same:.5g}")), "", "", "", ""))
            continue
        others = [f"{kind} {weight:.0%}" for kind, weight in entry["weights"].items() if kind != entry["chosen"]]
        opened = [_range(entry[f"{what}_left_open"]) for what in ("mean", "sd")]
        judged = f"{entry['fits'][0]['p_value']:.2g}"
        rows.append((name, entry["chosen"], judged, f"{entry['mean']:.5g}", opened[0], f"{entry['sd']:.4g}", opened[1],
                     ", ".join(others[:3])))  # fmt: skip
    if found["laws"] == "known":
        parts = [table(("input", "law", "fit (p)", "mean", "sd: scatter"), [(*r[:4], r[5]) for r in rows], width)]
        parts += ["fit (p): how often runs drawn from the law would lie as far from it"]
    else:
        header = ("input", "law", "fit (p)", "mean", "left open (95 %)", "sd: scatter", "left open (95 %)")
        parts = [table(header, [row[:-1] for row in rows], width)]
        parts += [f"{row[0]} may also be {row[-1]}" for row in rows if row[-1]]
        parts += [
            "fit (p): how often runs of the law itself would lie as far from it; below 0.01 it is refused",
            f"left open: what {found['rows']:,} runs do not know of the law, its family included; more runs narrow it, "
            "not the scatter",
        ]
    return parts + [f"{name}: {entry['reason']}" for name, entry in found["inputs"].items() if entry["reason"]]


def dependence_lines(found: Document) -> list[str]:
    """Which inputs depend on each other, or are given by others."""
    parts, tied = [], [pair for pair in found["dependence"] if pair["dependent"]]
    for pair in tied[:_MANY]:
        copula = pair.get("copula")
        taken = "" if copula in (None, "gaussian") else f", taken for a {copula.capitalize()} copula"
        said = f"{' and '.join(pair['of'])} depend on each other: rank correlation {_share(pair['spearman'])}{taken}"
        parts.append(said)
    if len(tied) > _MANY:
        parts.append(f"and {len(tied) - _MANY} pairs more")
    parts += found["combinations"][:_MANY]
    if not tied and found["dependence"]:
        parts.append("no two inputs depend on each other beyond chance")
    return parts


def _outputs(found: Document, width: int) -> str:
    """Statistics of every output, by the runs alone and by the expansion."""
    rows: list[tuple[str, ...] | str] = []
    for name, entry in found["outputs"].items():
        told = entry["expansion"]
        alone = [("mean", "mean", entry["mean"]), ("sd", "standard deviation", entry["sd"])]
        alone += [(p, f"{100.0 * float(p):g} % quantile", e) for p, e in entry["quantiles"].items()]
        rows.append(name)
        for key, label, estimate in alone:
            row: tuple[str, ...] = (label, _shown(estimate))
            if told is not None:
                row += (_shown(told[key]["whole"]),)
            rows.append(row + ("-",) * (3 - len(row)))
    if any(entry["expansion"] is not None for entry in found["outputs"].values()):
        return table(("output", "by the runs alone (95 %)", "by the expansion (95 %)"), rows, width)
    short = [row if isinstance(row, str) else row[:2] for row in rows]
    return table(("output", "value (95 % interval)"), short, width)


def _drivers(found: Document, width: int) -> str:
    """Indices of every output, by ranks and by the expansion; tables of those without one have one column less."""
    texts = []
    for kind, orders in (("dependent", ("shapley", "first", "total")), ("sobol", ("first", "total")), (None, ())):
        rows: list[tuple[str, ...] | str] = []
        for name, entry in found["sensitivity"].items():
            if entry["chaos"].get("kind") != kind:
                continue
            reasons = {estimate.get("reason") for estimate in entry["ranks"].values()}
            if len(reasons) == 1 and None not in reasons:
                texts.append(f"{name}: no index by ranks: {reasons.pop()}")
                continue
            rows.append(name)
            for source, estimate in entry["ranks"].items():
                row = [source, _shown(estimate)]
                for order in orders:
                    one = entry["chaos"].get(order, {}).get(source)
                    row.append("-" if one is None else _share(one["whole"]))
                rows.append(tuple(row))
        header = ("drivers", "first, by ranks (95 %)", *(f"{_ORDERS[order]}, by expansion" for order in orders))
        if rows:
            texts.append(table(header, rows, width))
    return "\n\n".join(text if "\n" in text else wrap(text, width) for text in texts)


def expansion_line(found: Document, name: str) -> str:
    """What the intervals of an expansion hold."""
    chaos = found["sensitivity"][name]["chaos"]
    entries = [e for order in _ORDERS for e in chaos.get(order, {}).values() if e["surrogate"]["value"] is not None]
    text = f"expansion: {chaos['reason']}"
    if not entries:
        return text
    own = max(0.5 * (e["surrogate"]["high"] - e["surrogate"]["low"]) for e in entries)
    opened = max(e["left_open"] for e in entries)
    if found["laws"] == "known":
        return f"{text}; its own error moves no index by more than {own:.1g}"
    return (
        f"{text}; its own error moves no index by more than {own:.1g}, what the runs leave open of the laws by up to "
        f"{opened:.1g}, and the intervals hold both. Where the laws are known, give them: --laws STUDY.toml"
    )


def study_text(found: Document) -> str:
    """The inputs as a black-box study would have them, to go on with; names that a study cannot have are changed."""
    called = _study_names([*found["inputs"], *found["outputs"]])
    lines = ["# laws fitted to given data; a study with these inputs runs with --model FILE.py:FUNCTION"]
    lines += [f"# {name} stands for the column {told(column, 80)}" for column, name in called.items() if name != column]
    lines += ["", "[inputs]"]
    given = set()
    for column, entry in found["inputs"].items():
        name = called[column]
        if entry.get("fixed") is not None:
            lines.append(f"{name} = {entry['fixed']!r}")
            continue
        if entry["chosen"] in (None, "kde", "empirical"):
            lines.append(f"# {name}: {told(entry['reason'])}; give it as an empirical law with its own CSV")
            continue
        given.add(column)
        keys = ", ".join(f"{key} = {value!r}" for key, value in entry["parameters"].items())
        lines.append(f'{name} = {{ dist = "{entry["chosen"]}", {keys} }}')
    for pair in found["dependence"]:
        if pair["dependent"] and given.issuperset(pair["of"]):
            names = ", ".join(f'"{called[column]}"' for column in pair["of"])
            # a study refuses inputs that give each other
            rank = min(max(pair["spearman"]["value"], -_STRONGEST), _STRONGEST)
            lines += ["", "[[dependence]]", f"of = [{names}]", f"spearman = {rank:.4f}"]
            if pair.get("copula") not in (None, "gaussian"):
                lines.append(f'copula = "{pair["copula"]}"')
    names = ", ".join(f'"{called[column]}"' for column in found["outputs"])
    return "\n".join([*lines, "", "[outputs]", f"names = [{names}]", ""])


def _study_names(columns: Sequence[str]) -> dict[str, str]:
    """Names that a study takes, each once, for columns: their own where they are such, else without unit and signs.

    >>> _study_names(["E [GPa]", "b", "E", "%"])
    {'b': 'b', 'E': 'E', 'E [GPa]': 'E_2', '%': 'column'}
    """
    called = {column: column for column in columns if valid_name(column) and column not in RESERVED}
    for column in columns:
        if column in called:
            continue
        name = "".join(c if valid_name(f"a{c}") else "_" for c in _UNIT.sub("", column)[:_LONGEST])
        stem = name if name.strip("_-") and valid_name(name) and name not in RESERVED else "column"
        name, number = stem, 1
        while name in called.values():
            number += 1
            name = f"{stem}_{number}"
        called[column] = name
    return called
