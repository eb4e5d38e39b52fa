"""The comparison of two runs as one self-contained page: figures inlined, no script, nothing fetched."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any, Final

from uqsphere.compare import PERHAPS, SURE, headline, subject_of
from uqsphere.compare import pictures as drawn
from uqsphere.errors import FolderError
from uqsphere.report import canvas
from uqsphere.report.blocks import Block
from uqsphere.report.canvas import Picture
from uqsphere.report.contents import read_contents
from uqsphere.report.html import new_environment
from uqsphere.report.sections import Table
from uqsphere.report.sheet import margin_boxes
from uqsphere.report.wording import (
    ABSENT,
    begin,
    call,
    estimate_text,
    limit_name,
    number_text,
    probability_text,
    symbol,
)
from uqsphere.store import write_atomically

__all__ = ["write_page"]

#: bytes of figures on the page, and rows of its longest table
MOST_INLINED: Final = 2_200_000
MOST_ROWS: Final = 400
_WORDS: Final = {True: "met", False: "not met", None: "undecided"}


def write_page(before: Path, after: Path, found: Mapping[str, Any], out: Path) -> Path:
    """Write the page of `uqsphere.compare.compare_folders`.

    Parameters
    ----------
    before, after : the two result folders.
    found : what was found.
    out : a file that ends in .html or .htm, or a folder, where it is compare.html.

    Raises
    ------
    FolderError
        When one of the folders is damaged, or `out` is a link.
    """
    page = out if out.suffix.lower() in (".html", ".htm") else out / "compare.html"
    if page.is_symlink():
        raise FolderError(f"{page} is a link: name another file")
    contents = read_contents(before), read_contents(after)
    shared = [name for name in contents[0].results["quantities"] if name in contents[1].results["quantities"]]
    laws = [
        Block(heading=begin(name, call(name)), finding=drawn.density_finding(*contents, name),
              picture=drawn.density_picture(*contents, name), table=_table(found, "quantities", name))
        for name in shared
    ]  # fmt: skip
    indices = [
        Block(heading=symbol(name), finding=picture.finding if picture else "", picture=picture,
              table=_table(found, "sensitivity", name))
        for name in shared
        if name in contents[0].results["sensitivity"] and name in contents[1].results["sensitivity"]
        for picture in (drawn.index_picture(*contents, name),)
    ]  # fmt: skip
    margins = [
        Block(heading=f"Fragility of {limit_name(name)}", finding=picture.finding if picture else "", picture=picture,
              table=_table(found, "margins", f"limits.{name}"))
        for name in contents[0].results["margins"]
        if name in contents[1].results["margins"]
        for picture in (drawn.fragility_picture(*contents, name),)
    ]  # fmt: skip
    write_atomically(page, _page(found, {"laws": laws, "indices": indices, "margins": margins}))
    return page


#: what a table of a section is about
_SUBJECTS: Final = {
    "quantities": "{name}",
    "sensitivity": "Indices of {name}",
    "margins": "Margins, {name}",
    "limits": "Limits",
}


def _table(found: Mapping[str, Any], section: str, name: str) -> Table:
    """Before, after and difference of every answer of a section."""
    rows = [
        (str(c["statistic"]), _cell(c, "before"), _cell(c, "after"), _difference(c), _share(c), str(c["verdict"]))
        for c in found["changes"]
        if c["section"] == section and (not name or c["name"] == name)
    ]  # fmt: skip
    return Table(
        # a caption of its own: it names the region for those who cannot see what stands above it
        caption=f"{_SUBJECTS[section].format(name=name)}: before, after, and after minus before, with 95 % intervals",
        header=("answer", "before", "after", "difference", "in per cent", "change"),
        rows=tuple(rows[:MOST_ROWS]),
    )


def _cell(change: Mapping[str, Any], side: str) -> str:
    if str(change["statistic"]).startswith(("censored share", "probability of missing the aim")):
        return probability_text(change[side])
    return estimate_text(change[side], subject_of(change))


def _difference(change: Mapping[str, Any]) -> str:
    if change["difference"] is None:
        return ABSENT
    if change["difference"] == 0.0:
        return "none"
    return estimate_text(
        {"value": change["difference"], "low": change["low"], "high": change["high"]}, subject_of(change)
    )


def _share(change: Mapping[str, Any]) -> str:
    if change["relative"] is None or change["section"] == "sensitivity":
        return ABSENT
    return number_text(f"{100.0 * change['relative']:+.3g}") + " %"


def _limits(found: Mapping[str, Any]) -> list[dict[str, Any]]:
    """One box per limit: its verdict before and after, and its probability."""
    boxes = []
    for entry in found["limits"]:
        name = entry["limit"]
        words = [
            _WORDS[entry[side]] if entry[f"target_{side}"] is not None else "no target" for side in ("before", "after")
        ]
        miss = next(c for c in found["changes"] if c["name"] == f"limits.{name}" and c["section"] == "limits")
        texts = [probability_text(miss[side]) for side in ("before", "after")]
        line = f"Probability of missing its aim: {texts[0]} before, {texts[1]} after."
        if miss["verdict"] in (SURE, PERHAPS) and miss["relative"] is not None:
            sign = "more" if miss["relative"] > 0.0 else "less"
            doubt = "" if miss["verdict"] == SURE else ", which may be chance"
            share = number_text(f"{100.0 * abs(miss['relative']):.3g}")
            line += f" That is {share} % {sign}{doubt}."
        elif miss["difference"] is not None:
            line += " No difference is seen above the intervals."
        boxes.append({"name": canvas.shorten(name, 80), "before": words[0], "after": words[1], "line": line})
    return boxes


def _page(found: Mapping[str, Any], parts: Mapping[str, list[Block]]) -> str:
    from markupsafe import Markup

    room, taken = MOST_INLINED, list[str]()

    def placed(picture: Picture) -> Any:
        nonlocal room
        # p_max and P_max are drawn under the same name
        taken.append(picture.name)
        element = canvas.inline(canvas.render(picture), f"{picture.name}-{len(taken)}")
        room -= len(element.encode())
        # the one text that is not escaped: made of escaped parts by the XML writer
        return Markup(element) if room >= 0 else "The figure is left out: the page would become too large with it."

    environment = new_environment()
    environment.filters["drawn"] = placed
    template = environment.from_string(resources.files("uqsphere.compare").joinpath("page.html").read_text("utf-8"))
    causes = Table(
        caption="What was changed in the study",
        header=("number or choice", "before", "after"),
        rows=tuple((c["what"], c["before"], c["after"]) for c in found["causes"][:MOST_ROWS]),
    )
    moved = drawn.moved_picture(found)
    runs = Table(
        caption="The two runs",
        header=("", "before", "after"),
        rows=tuple(
            (words, _shown(found["before"][key]), _shown(found["after"][key]))
            for key, words in (("folder", "folder"), ("title", "title"), ("hash", "study"), ("seed", "seed"),
                               ("version", "uqsphere"), ("model", "model"), ("evaluations", "evaluations"))
        ),
    )  # fmt: skip
    titles = list(dict.fromkeys(str(found[side]["title"]) for side in ("before", "after")))
    return (
        template.render(
            version="",
            title=" / ".join(titles),
            margin_boxes=Markup(margin_boxes(" / ".join(titles), {})),
            headline=headline(found),
            boxes=_limits(found),
            causes=causes,
            moved=Block(heading="What moved", finding=moved.finding, picture=moved) if moved else None,
            limits=_table(found, "limits", ""),
            parts=parts,
            runs=runs,
            alone=[("before", found["only_before"][:200]), ("after", found["only_after"][:200])],
            compared=found["compared"],
            perhaps=found["perhaps"],
            same_seed=found["before"]["seed"] == found["after"]["seed"],
        )
        + "\n"
    )


def _shown(value: Any) -> str:
    return "–" if value is None else (f"{value:,}".replace(",", "\u202f") if isinstance(value, int) else str(value))
