"""What each command does that looks at what is there: report, show, export, compare, verify."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from uqsphere.console import answer, plain
from uqsphere.errors import FolderError, ModelError, UsageError

#: what reading entries that do not fit together raises; a fault of ours would look the same, so that the
#: message says how to see it
_MISFITS = (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError, RecursionError,
            MemoryError, NotImplementedError)  # fmt: skip


@contextlib.contextmanager
def _believed(*folders: Path) -> Iterator[None]:
    """Folders whose content is not ours: where it cannot be shown, that is their damage."""
    try:
        yield
    except _MISFITS as error:
        if os.environ.get("UQSPHERE_DEBUG"):
            raise
        raise FolderError(
            f"{' or '.join(map(str, folders))} is damaged: what is stored does not fit together "
            f"({type(error).__name__}: {str(error)[:200]}); set UQSPHERE_DEBUG=1 to see where"
        ) from error


def command_report(chosen: argparse.Namespace) -> int:
    """Build the report again from what is stored."""
    from uqsphere.report import build_report
    from uqsphere.report.page import build_brief, build_pdf, check_pdf
    from uqsphere.runner.finished import open_run

    if chosen.pdf:
        check_pdf()
    with _believed(chosen.folder):
        folder = open_run(chosen.folder).folder
        written = {"brief": build_brief(folder)} if chosen.brief else {"report": build_report(folder)}
        if chosen.pdf:
            written["pdf"] = build_brief(folder, pdf=True) if chosen.brief else build_pdf(folder, full=chosen.full)
    named = {name: str(path) for name, path in written.items()}
    return answer(chosen, named, "\n".join(f"{name}: {plain(path)}" for name, path in named.items()))


def command_show(chosen: argparse.Namespace) -> int:
    """The answers of a run as a table."""
    from uqsphere.report.brief import summary_of
    from uqsphere.report.contents import read_contents
    from uqsphere.runner.finished import open_run

    with _believed(chosen.folder):
        found = open_run(chosen.folder)
        return answer(chosen, found.results.document(), lambda: summary_of(read_contents(found.folder)))


def command_export(chosen: argparse.Namespace) -> int:
    """Samples and tables of a run in another format."""
    from uqsphere.runner.finished import export_run, open_run

    with _believed(chosen.folder):
        written = export_run(open_run(chosen.folder), chosen.format, chosen.out or chosen.folder / "export")
    paths = [str(path) for path in written]
    return answer(chosen, {"written": paths}, "\n".join(map(plain, paths)))


def command_verify(chosen: argparse.Namespace) -> int:
    """Whether a result folder is whole."""
    from uqsphere.cli.verify import DAMAGED, FICKLE, verify_folder, verify_text

    if not 0 <= chosen.chunks <= 10_000_000:
        raise UsageError(f"--chunks takes 0 and more, found {chosen.chunks}")
    if chosen.seed < 0:
        raise UsageError(f"--seed takes 0 and more, found {chosen.seed}")
    with _believed(chosen.folder):
        found = verify_folder(chosen.folder, chunks=chosen.chunks, seed=chosen.seed, model=chosen.model)
    answer(chosen, found.document(), lambda: verify_text(found))
    if found.verdict == DAMAGED:
        raise FolderError(f"{chosen.folder} is damaged")
    if found.verdict == FICKLE:
        raise ModelError(f"{chosen.model} is not deterministic: {chosen.folder} is not damaged, and cannot be repeated")
    return 0


def command_compare(chosen: argparse.Namespace) -> int:
    """Two runs side by side."""
    from uqsphere.report.compare import compare_folders, comparison_text, write_page

    with _believed(chosen.before, chosen.after):
        found = compare_folders(chosen.before, chosen.after)
        if chosen.out is not None:
            page = write_page(chosen.before, chosen.after, found, chosen.out)
            found = found.model_copy(update={"page": str(page)})
    return answer(chosen, found.document(), lambda: comparison_text(found))
