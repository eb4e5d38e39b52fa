"""`uqsphere shpb records | fit-contact | plan`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from uqsphere.documents import load_document
from uqsphere.errors import UsageError, as_text
from uqsphere.labs.files import csv_text, finish, table
from uqsphere.labs.shpb.document import RecordDocument


def main(argv: Sequence[str]) -> int:
    """Run a command of the lab; its exit code is 2 where no record can be read."""
    parser = argparse.ArgumentParser(prog="uqsphere shpb", description=__doc__)
    commands = parser.add_subparsers(required=True)
    for name, command, text in (
        ("records", _records, "forces at the faces of a specimen from gauge records"),
        (
            "fit-contact",
            _fit_contact,
            "contact law of a sphere that yields, from a slow load-unload record",
        ),
        ("plan", _plan, "which speed or height breaks which share"),
    ):
        one = commands.add_parser(name, help=text, description=text)
        one.set_defaults(command=command)
        one.add_argument(
            "file", type=Path, nargs="+" if name == "records" else None, help="input file (TOML)"
        )
        one.add_argument("--out", type=Path, help="folder for the files that are written")
        one.add_argument("--json", action="store_true", help="one JSON document on stdout")
    chosen = parser.parse_args(argv)
    return chosen.command(chosen) or 0


def _records(chosen: argparse.Namespace) -> int:
    """Every input file: its sheet; of several also tests.csv, one line a test."""
    from uqsphere.labs.shpb import sheet
    from uqsphere.labs.shpb.record import load_record
    from uqsphere.labs.shpb.waves import read_test

    several = len(chosen.file) > 1
    lines, contents, texts, files, refused = list[list[str]](), [], [], dict[str, str](), 0
    for path in chosen.file:
        asked = load_document(path, RecordDocument)
        try:
            test = read_test(load_record(asked, path.parent), asked)
        except UsageError as error:
            if not several:
                raise
            refused += 1
            lines.append([path.stem, "", "", "", "", f"refused: {error}"])
            contents.append({"file": str(path), "refused": str(error)})
            texts.append(f"{path}: refused: {error}")
            continue
        if not chosen.json:
            print(
                "".join(f"{path.name}: {c.step}: {c.text}\n" for c in test.changes),
                end="",
                file=sys.stderr,
            )
        contents.append({"file": str(path), "title": asked.title, **sheet.document(test)})
        texts.append(f"{as_text(asked.title or path.name)}\n" + table(sheet.rows(test)))
        best = test.peaks["B"]
        diameter = asked.specimen.diameter
        lines.append(
            [
                path.stem,
                "" if diameter is None else f"{diameter * 1e3:.6g}",
                f"{best.value * 1e-3:.5g}",
                f"{best.low * 1e-3:.5g}",
                f"{best.high * 1e-3:.5g}",
                "; ".join(best.doubts),
            ]
        )
        folder = f"{path.stem}/" if several else ""
        files[f"{folder}forces.csv"], files[f"{folder}pulse.csv"] = (
            sheet.forces_csv(test),
            sheet.pulse_csv(test),
        )
        files[f"{folder}sheet.html"] = sheet.page(test, asked, asked.record.file)
    if several:
        head = ["test", "diameter [mm]", "force [kN]", "low [kN]", "high [kN]", "doubts"]
        files["tests.csv"] = csv_text(head, [*zip(*lines, strict=True)])
    finish(chosen, {"tests": contents} if several else contents[0], "\n\n".join(texts), files)
    return 2 if refused == len(chosen.file) else 0


def _fit_contact(chosen: argparse.Namespace) -> None:
    from uqsphere.labs.shpb.contact import ContactDocument, fit_contact, load_loading

    asked = load_document(chosen.file, ContactDocument)
    displacement, force, notes = load_loading(asked, chosen.file.parent)
    fit = fit_contact(displacement, force, asked)
    for note in (*notes, *fit.notes):
        print(f"note: {note}", file=sys.stderr)
    lines = fit.lines()
    finish(
        chosen,
        {**asdict(fit), "toml": lines},
        table(fit.rows()) + "\n\n" + lines,
        {"contact.toml": lines},
    )


def _plan(chosen: argparse.Namespace) -> None:
    from uqsphere.labs.shpb.plan import PlanDocument, plan_csv, plan_test, plan_text

    plan = plan_test(load_document(chosen.file, PlanDocument), chosen.file.parent)
    finish(chosen, plan, plan_text(plan), {"plan.csv": plan_csv(plan)})
