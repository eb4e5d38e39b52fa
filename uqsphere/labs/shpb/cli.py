"""`uqsphere shpb records | fit-contact | plan`."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from uqsphere.errors import AccessError, UqsphereError, UsageError
from uqsphere.labs.shpb.document import RecordDocument, load_document


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command of the lab; exit codes 0, 2 (usage, or a record that cannot be read so), 6 (files)."""
    parser = argparse.ArgumentParser(prog="uqsphere shpb", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    for name, text in (
        ("records", "forces at the faces of a specimen from gauge records"),
        ("fit-contact", "contact law of a sphere that yields, from a slow load-unload record"),
        ("plan", "which speed or height breaks which share"),
    ):
        one = commands.add_parser(name, help=text, description=text)
        one.add_argument("file", type=Path, nargs="+" if name == "records" else None, help="input file (TOML)")
        one.add_argument("--out", type=Path, help="folder for the files that are written")
        one.add_argument("--json", action="store_true", help="one JSON document on stdout")
    try:
        chosen = parser.parse_args(argv)
    except SystemExit as ended:
        return int(ended.code or 0)
    try:
        return {"records": _records, "fit-contact": _fit_contact, "plan": _plan}[chosen.command](chosen)
    except UqsphereError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code


def table(rows: Sequence[Sequence[str]]) -> str:
    """Aligned columns; the last one is not padded."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]) - 1)]
    lines = ["  ".join([*(c.ljust(w) for c, w in zip(row, widths, strict=False)), row[-1]]).rstrip() for row in rows]
    return "\n".join("".join(c if c.isprintable() else "?" for c in line) for line in lines)


def write_files(folder: Path, texts: Mapping[str, str]) -> list[str]:
    """Files of a folder, each written whole."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            part = folder / f".{name}.part"
            part.write_text(text, encoding="utf-8", newline="")
            part.replace(folder / name)
    except OSError as error:
        raise AccessError(f"{folder}: {error.strerror or error}") from None
    return [str(folder / name) for name in texts]


def show(chosen: argparse.Namespace, content: Any, text: str, written: Sequence[str]) -> None:
    """The answer on stdout."""
    if chosen.json:
        print(json.dumps({**content, "written": list(written)}, indent=1, allow_nan=False))
    else:
        print("\n".join([text, *(f"wrote {path}" for path in written)]))


def _records(chosen: argparse.Namespace) -> int:
    """Every input file: its sheet; of several also tests.csv, one line a test."""
    from uqsphere.labs.shpb import sheet
    from uqsphere.labs.shpb.record import load_record
    from uqsphere.labs.shpb.waves import read_test

    lines, contents, texts, written, refused = [], [], [], [], 0
    for path in chosen.file:
        asked = load_document(path, RecordDocument)
        try:
            record = load_record(asked, path.parent)
            test = read_test(record, asked)
        except UsageError as error:
            if len(chosen.file) == 1:
                raise
            refused += 1
            lines.append([path.stem, "", "", "", "", f"refused: {error}"])
            contents.append({"file": str(path), "refused": str(error)})
            texts.append(f"{path}: refused: {error}")
            continue
        content = {"file": str(path), "title": asked.title, **sheet.document(test)}
        notes = [f"{c.step}: {c.text}" for c in test.changes]
        if not chosen.json:
            print("".join(f"{path.name}: {note}\n" for note in notes), end="", file=sys.stderr)
        contents.append(content)
        texts.append(f"{asked.title or path.name}\n" + table(sheet.rows(test)))
        best = test.peaks["B"]
        diameter = asked.specimen.diameter
        lines.append([path.stem, "" if diameter is None else f"{diameter * 1e3:.6g}", f"{best.value * 1e-3:.5g}",
                      f"{best.low * 1e-3:.5g}", f"{best.high * 1e-3:.5g}", "; ".join(best.doubts)])  # fmt: skip
        if chosen.out is not None:
            end = record.incident.wave.end - record.incident.wave.foot
            files = {"forces.csv": sheet.forces_csv(test), "pulse.csv": sheet.pulse_csv(test, end),
                     "sheet.html": sheet.page(test, asked, asked.record.file)}  # fmt: skip
            written += write_files(chosen.out / path.stem if len(chosen.file) > 1 else chosen.out, files)
    if len(chosen.file) > 1 and chosen.out is not None:
        import csv
        import io

        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["test", "diameter [mm]", "force [kN]", "low [kN]", "high [kN]", "doubts"])
        writer.writerows(lines)
        written += write_files(chosen.out, {"tests.csv": text.getvalue()})
    content = contents[0] if len(contents) == 1 else {"tests": contents}
    show(chosen, content, "\n\n".join(texts), written)
    return 2 if refused == len(chosen.file) else 0


def _fit_contact(chosen: argparse.Namespace) -> int:
    from uqsphere.labs.shpb.contact import ContactDocument, fit_contact, load_loading

    asked = load_document(chosen.file, ContactDocument)
    loading = load_loading(asked, chosen.file.parent)
    fit = fit_contact(loading, asked)
    for note in (*loading.notes, *fit.notes):
        print(f"note: {note}", file=sys.stderr)
    lines = fit.lines()
    written = write_files(chosen.out, {"contact.toml": lines}) if chosen.out is not None else []
    show(chosen, {**asdict(fit), "toml": lines}, table(fit.rows()) + "\n\n" + lines, written)
    return 0


def _plan(chosen: argparse.Namespace) -> int:
    from uqsphere.labs.shpb.plan import PlanDocument, plan_test

    plan = plan_test(load_document(chosen.file, PlanDocument), chosen.file.parent)
    written = write_files(chosen.out, {"plan.csv": plan.csv()}) if chosen.out is not None else []
    show(chosen, plan.content(), plan.text(), written)
    return 0
