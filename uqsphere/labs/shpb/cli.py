"""`uqsphere shpb records | fit-contact | plan`."""

import os
from argparse import Namespace
from dataclasses import asdict
from pathlib import Path

from uqsphere.documents import load_document
from uqsphere.errors import AccessError, UsageError, as_text, tell
from uqsphere.labs.files import JsonObject, csv_text, finish, named_by, table

from .document import RecordDocument


def _records(chosen: Namespace) -> int:
    """Every input file: its sheet; of several also tests.csv, one line a test; exit code 2 if no
    record can be read.  Files of one name are told apart by their folders.
    """
    from . import sheet
    from .mending import load_record
    from .waves import read_test

    several = len(chosen.file) > 1
    stems = [path.stem for path in chosen.file]
    home = os.path.commonpath([path.resolve().parent for path in chosen.file])
    records = dict[Path, str]()
    lines = []
    texts = []
    files = dict[str, str]()
    contents = list[JsonObject]()
    for path in chosen.file:
        name = path.stem
        if stems.count(name) > 1:
            name = path.resolve().relative_to(home).as_posix()
        asked = load_document(path, RecordDocument)
        try:
            with named_by(path, "record", "file"):
                test = read_test(load_record(asked, path.parent))
        except (UsageError, AccessError) as error:
            if not several:
                raise
            lines.append((name, "", "", "", "", f"refused: {error}"))
            contents.append({"file": str(path), "refused": str(error)})
            texts.append(f"{path}: refused: {error}")
            continue
        record = (path.parent / asked.record.file).resolve()
        if record in records:
            tell(f"{path.name}: the record of {records[record]}: one test, two lines of tests.csv")
        records[record] = path.name
        if not chosen.json:
            for change in test.changes:
                tell(f"{path.name}: {change.step}: {change.text}")
        contents.append({"file": str(path), "title": asked.title, **sheet.document(test)})
        texts.append(f"{as_text(asked.title or path.name)}\n" + table(sheet.rows(test)))
        peak = test.peaks["B"]
        diameter = ""
        if asked.specimen.diameter:
            diameter = f"{asked.specimen.diameter * 1e3:.6g}"
        forces = [f"{force * 1e-3:.5g}" for force in (peak.value, peak.low, peak.high)]
        lines.append((name, diameter, *forces, "; ".join(peak.doubts)))
        folder = f"{name}/" if several else ""
        files |= {folder + file: text for file, text in sheet.written(test, asked).items()}
    content = contents[0]
    if several:
        files["tests.csv"] = csv_text(
            lines, ["test", "diameter [mm]", "force [kN]", "low [kN]", "high [kN]", "doubts"]
        )
        content = {"tests": contents}
    finish(chosen, content, "\n\n".join(texts), files)
    return 2 if all("refused" in content for content in contents) else 0


def _fit_contact(chosen: Namespace) -> None:
    from .contact import ContactDocument, fit_contact

    asked = load_document(chosen.file, ContactDocument)
    with named_by(chosen.file, "file"):
        fit = fit_contact(asked, chosen.file.parent)
    for note in fit.notes:
        tell(f"note: {note}")
    lines = fit.lines()
    text = f"{table(fit.rows())}\n\n{lines}"
    finish(chosen, {**asdict(fit), "toml": lines}, text, {"contact.toml": lines})


def _plan(chosen: Namespace) -> None:
    from .plan import PlanDocument, plan_csv, plan_test, plan_text

    asked = load_document(chosen.file, PlanDocument)
    with named_by(chosen.file, "study"):
        plan = plan_test(asked, chosen.file.parent)
    finish(chosen, plan, plan_text(plan), {"plan.csv": plan_csv(plan)})


#: what each command runs, and its help
COMMANDS = {
    "records": (_records, "forces at the faces of a specimen from gauge records"),
    "fit-contact": (
        _fit_contact,
        "contact law of a sphere that yields, from a slow load-unload record",
    ),
    "plan": (_plan, "speed, height or force at which a share of the spheres breaks"),
}
