"""`uqsphere shpb records | fit-contact | plan`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from uqsphere.documents import load_document
from uqsphere.errors import UsageError
from uqsphere.labs.files import csv_text, run_command, show, table, write_files
from uqsphere.labs.shpb.document import RecordDocument


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
    return run_command(argv, parser, {"records": _records, "fit-contact": _fit_contact, "plan": _plan})


def _records(chosen: argparse.Namespace) -> int:
    """Every input file: its sheet; of several also tests.csv, one line a test."""
    from uqsphere.labs.shpb import sheet
    from uqsphere.labs.shpb.record import load_record
    from uqsphere.labs.shpb.waves import read_test

    lines, contents, texts, written, refused = [], [], [], [], 0
    for path in chosen.file:
        asked = load_document(path, RecordDocument)
        try:
            test = read_test(load_record(asked, path.parent), asked)
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
            files = {"forces.csv": sheet.forces_csv(test), "pulse.csv": sheet.pulse_csv(test),
                     "sheet.html": sheet.page(test, asked, asked.record.file)}  # fmt: skip
            written += write_files(chosen.out / path.stem if len(chosen.file) > 1 else chosen.out, files)
    if len(chosen.file) > 1 and chosen.out is not None:
        head = ["test", "diameter [mm]", "force [kN]", "low [kN]", "high [kN]", "doubts"]
        written += write_files(chosen.out, {"tests.csv": csv_text(head, [*zip(*lines, strict=True)])})
    content = contents[0] if len(contents) == 1 else {"tests": contents}
    show(chosen, content, "\n\n".join(texts), written)
    return 2 if refused == len(chosen.file) else 0


def _fit_contact(chosen: argparse.Namespace) -> int:
    from uqsphere.labs.shpb.contact import ContactDocument, fit_contact, load_loading

    asked = load_document(chosen.file, ContactDocument)
    displacement, force, notes = load_loading(asked, chosen.file.parent)
    fit = fit_contact(displacement, force, asked)
    for note in (*notes, *fit.notes):
        print(f"note: {note}", file=sys.stderr)
    lines = fit.lines()
    written = write_files(chosen.out, {"contact.toml": lines}) if chosen.out is not None else []
    show(chosen, {**asdict(fit), "toml": lines}, table(fit.rows()) + "\n\n" + lines, written)
    return 0


def _plan(chosen: argparse.Namespace) -> int:
    from uqsphere.labs.shpb.plan import PlanDocument, plan_csv, plan_test, plan_text

    plan = plan_test(load_document(chosen.file, PlanDocument), chosen.file.parent)
    written = write_files(chosen.out, {"plan.csv": plan_csv(plan)}) if chosen.out is not None else []
    show(chosen, plan, plan_text(plan), written)
    return 0
