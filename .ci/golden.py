"""What a reader sees of shipped studies, value and interval: made by one command, compared before
and after a change.

    python .ci/golden.py make OUT.json [STUDY...]    runs the studies, all of STUDIES without a name
    python .ci/golden.py compare BEFORE.json AFTER.json

A change is fine where intervals overlap and no width grows by more than half (exit code 0, else 1).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

STUDIES = (
    "granite",
    "granite_10mm_test",
    "granite_three_ways",
    "glass_bead_small_bar",
    "limestone_margin",
    "limestone_three_ways",
    "limestone_drop_weight",
    "limestone_ball_slow",
    "quartz_load_cell",
    "blackbox",
    "ishigami",
)
MODELS = {"blackbox": "blackbox.py:model", "ishigami": "ishigami.py:ishigami"}
#: loose, so that all studies take a minute
ACCURACY = "analysis.accuracy={ mean = 0.01, quantile = 0.05, sobol = 0.02, probability = 0.05 }"
#: answers that stand on the page; curves and drivers are figures
SEEN = (
    "mean",
    "sd",
    "quantile",
    "sobol_first",
    "sobol_total",
    "censored_share",
    "failure_probability",
    "reliability_index",
    "margin",
)
#: intervals may grow by this factor
GROWTH = 1.5
#: where an interval has no width, values may differ by this share, and a width below this share of
#: the value is none
EXACT = 1e-3

Row = list[
    str | float | None
]  # subject, answer, at, value, low, high; a verdict has its word as value


def rows_of(results: dict) -> list[Row]:
    """The rows that a reader sees, numbers to six digits, verdicts last."""

    def short(x: float | None) -> float | None:
        return None if x is None else float(f"{x:.6g}")

    rows: list[Row] = []
    for row in results["answers"]:
        assumed = str(row["at"]).startswith(("assumed:", "tests"))
        if row["answer"] in SEEN and not assumed:
            rows.append(
                [
                    row["subject"],
                    row["answer"],
                    row["at"],
                    *(short(row[k]) for k in ("value", "low", "high")),
                ]
            )
    for decision in results["decisions"]:
        aim, use = decision["aim"], decision["use"]
        rows.append([aim, "verdict", "", decision["verdict"], None, None])
        if use is not None:
            # its own accuracy is that of a probability
            number = short(use["value"])
            rows.append([aim, "number to use", "", number, number * 0.95, number * 1.05])
    return rows


def make(out: Path, names: list[str]) -> None:
    """Run the studies and write their rows, one a line."""
    import uqsphere
    from uqsphere.study import shipped_studies

    shipped = shipped_studies()
    table = {}
    for name in names or STUDIES:
        if name not in shipped:
            print(f"{name}: no longer shipped", file=sys.stderr)
            continue
        model = str(shipped[name].parent / MODELS[name]) if name in MODELS else None
        found = uqsphere.run(uqsphere.load_study(shipped[name], [ACCURACY]), model, threads=1)
        table[name] = rows_of(found.results.model_dump(mode="json"))
        print(
            f"{name}: {len(table[name])} rows, {found.results.accuracy.runs:,} model runs",
            file=sys.stderr,
        )
    write(out, table)


def write(out: Path, table: dict[str, list[Row]]) -> None:
    parts = []
    for name, rows in table.items():
        parts.append(
            f"{json.dumps(name)}: [\n" + ",\n".join(json.dumps(row) for row in rows) + "\n]"
        )
    out.write_text("{\n" + ",\n".join(parts) + "\n}\n", encoding="utf-8")


def compare(before: Path, after: Path) -> int:
    """Print rows that are gone, new, moved or wider; the number of those that moved or widened."""
    old, new = (json.loads(path.read_text("utf-8")) for path in (before, after))
    bad = same = 0
    for name in old:
        if name not in new:
            print(f"{name}: gone")
            continue
        a, b = ({tuple(row[:3]): row[3:] for row in table[name]} for table in (old, new))
        for kind, keys in (("gone", a.keys() - b.keys()), ("new", b.keys() - a.keys())):
            for key in sorted(keys, key=str):
                print(f"{name}: {kind}: {' '.join(map(str, key)).strip()}")
        for key in [key for key in a if key in b]:
            fault = change(a[key], b[key])
            bad, same = bad + bool(fault), same + (not fault)
            if fault:
                print(f"{name}: {fault}: {' '.join(map(str, key)).strip()}: {a[key]} -> {b[key]}")
    print(f"{same} rows agree, {bad} moved or widened")
    return bad


def change(a: Row, b: Row) -> str:
    """What is wrong with `b` beside `a`: value, low, high of the same answer; nothing if it is
    fine.
    """
    if None in a[1:] or None in b[1:]:
        both = isinstance(a[0], float) and isinstance(b[0], float)
        fine = abs(a[0] - b[0]) <= EXACT * abs(a[0]) if both else a[0] == b[0]
        return "" if fine else "changed"
    if a[0] is None or b[0] is None:
        return "" if a[0] is b[0] is None else "absent"
    slack = EXACT * max(abs(a[0]), abs(b[0]))
    if max(a[1], b[1]) > min(a[2], b[2]) + slack:
        return "moved"
    return "wider" if b[2] - b[1] > GROWTH * (a[2] - a[1]) + 2 * slack else ""


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["make", out, *names]:
            make(Path(out), names)
        case ["compare", before, after]:
            sys.exit(1 if compare(Path(before), Path(after)) else 0)
        case _:
            sys.exit(__doc__)
