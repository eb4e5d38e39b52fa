"""One self-contained page from a finished run: figures inlined, nothing fetched, one script of its own."""

from __future__ import annotations

import base64
import hashlib
import html
import io
import logging
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from uqsphere.errors import UsageError
from uqsphere.quantities import reading_units
from uqsphere.report.brief import make_brief, summary_of
from uqsphere.report.chapters import CHAPTERS, build_chapters, service_chapters
from uqsphere.report.contents import Contents, read_contents, units_of
from uqsphere.report.figures.brief import curve_drawings, mode_dots
from uqsphere.report.figures.canvas import (
    APOSTROPHE,
    Picture,
    inline,
    legend_above,
    new_figure,
    on_paper,
    render,
    shorten,
)
from uqsphere.report.phrases import Block, Chapter, short_share, two
from uqsphere.report.tables import commands, repeat_rows
from uqsphere.report.whatif import panels
from uqsphere.results import Results
from uqsphere.results.entries import Fields, Manifest, read_resolved
from uqsphere.runner.beside import may_copy, shared_out
from uqsphere.store import csv_text, write_atomically, write_sums

if TYPE_CHECKING:
    from jinja2 import Environment
    from weasyprint import Document

# --- What paper has beside the page: number, title and day of the run in the margins, lines that keep numbers whole.

#: letters of a title in the margin
_LONGEST: Final = 90

_UNIT: Final = re.compile(r"(?<=[\d)]) (?=%|[µmkMG]?(?:Pa|N|m|s|J)\b|m/s|kg/m)")
_POWER: Final = re.compile(r"(?<=\d) × (?=10)")
_INTERVAL: Final = re.compile(r"\([−\d][^()]* to [^()]*\)")
_QUOTED: Final = re.compile(r'(?<![\w=])"([^"=\n]{1,200})"(?!\w)')
_COMMAS: Final = re.compile(r"(?<![\w.,])\d{1,3}(?:,\d{3})+(?![\w,]|\.\d)")


def unbroken(text: str) -> str:
    """The text with one kind of thousands, and numbers that stay on one line with their powers, units and intervals.

    >>> unbroken("1,234 runs, 1.2 × 10⁻⁴ (1.1 × 10⁻⁴ to 1.3 × 10⁻⁴)").replace("\u00a0", "~").replace("\u202f", "_")
    '1_234 runs, 1.2~×~10⁻⁴ (1.1~×~10⁻⁴~to~1.3~×~10⁻⁴)'
    >>> unbroken("1.447 (1.445 to 1.449) %").replace("\u00a0", "~")
    '1.447 (1.445~to~1.449)~%'
    >>> unbroken('the bar\\'s end, "steels, 1976"')
    'the bar’s end, “steels, 1976”'
    """
    text = _QUOTED.sub("“\\1”", APOSTROPHE.sub("’", text))
    text = _COMMAS.sub(lambda found: found[0].replace(",", "\u202f"), text)
    text = _UNIT.sub("\u00a0", _POWER.sub("\u00a0×\u00a0", text))
    # letters of an interval that is kept on one line: a longer one would not fit a narrow column
    return _INTERVAL.sub(lambda found: found[0].replace(" ", "\u00a0") if len(found[0]) <= 34 else found[0], text)


def margin_boxes(title: str, manifest: Manifest) -> str:
    """The style sheet of the margins of paper; the day is that of the run, where its manifest has one."""
    # in a text of a style sheet nothing but letters, numerals and spaces stands for itself
    day = f"run of {manifest.finished[:10]}" if manifest.finished else ""
    left, right = (
        '"' + "".join(c if c.isalnum() or c == " " else f"\\{ord(c):x} " for c in text) + '"' if text else "none"
        for text in (shorten(title, _LONGEST), day)
    )
    face = 'font: 8pt system-ui, "DejaVu Sans", sans-serif; color: #444444'
    return (
        f"@page {{ @top-left {{ content: {left}; {face}; width: 75%; }} @top-right {{ content: {right}; {face}; }}\n"
        f'  @bottom-right {{ content: counter(page) " / " counter(pages); {face}; }} }}\n'
        "@page :first { @top-left { content: none; } }\n"
    )


# --- The words of the trade that a page uses, each in a plain sentence.

#: (word, what it is found by, its meaning), in the order of the alphabet
GLOSSARY: Final[tuple[tuple[str, str, str], ...]] = (
    ("Borgonovo’s δ", r"Borgonovo",
     "How far a quantity’s distribution moves, on average, once an input is known: 0 not at all, 1 wholly."),
    ("row", r"\brows?\b",
     "One combination of all the random numbers of the study, computed: as one test in the laboratory would be."),
    ("censored", r"censored|outlast",
     "Known as a lower bound only, because the record ended first."),
    ("coefficient of variation", r"coefficient of variation",
     "Standard deviation over mean."),
    ("control variate", r"control variate",
     "A cheaper model, computed beside the expensive one, whose known mean takes scatter out of the estimate."),
    ("demand", r"\bdemand\b",
     "What the impact asks of the sphere, the quantity that a limit compares with the strength."),
    ("design point", r"\bdesign point",
     "Of all combinations of inputs that miss the aim, the likeliest; the reliability index is its distance."),
    ("direction cosines, importance factor", r"direction cosines|importance factor",
     "How much of the way from the means to the design point goes along each input; squared they sum to one. Standard "
     "normal space is where every input is measured in its own standard deviations, made independent."),
    ("first and total index (Sobol’)", r"first index|total index|first \(alone\)|Sobol’ ind",
     "Shares of the variance of a quantity: what an input causes alone, and what it causes with all its interactions."),
    ("force difference", r"force[_ ]balance|contact forces differ",
     "Difference of the forces at both faces of the sphere over the largest force."),
    ("fragility", r"[Ff]ragility",
     "The probability that the limit is exceeded, over a number such as the speed."),
    ("full, massless, linear (model)", r"\bmassless\b|\blinear model|model is full|model is linear",
     "Full: the sphere’s own inertia counts and both contacts are nonlinear. Massless: its inertia is left out. "
     "Linear: its contacts are springs of one stiffness, so that the motion is known in closed form."),
    ("Gaussian copula", r"[Gg]aussian copula",
     "The way in which two numbers depend on each other: as two normal numbers of that correlation, each then turned "
     "into its own law."),
    ("Kucherenko’s indices", r"Kucherenko",
     "First and total index of inputs that depend on each other."),
    ("law", r"\blaws?\b",
     "How a random number is distributed, with its kind and its parameters."),
    ("margin", r"\b[Mm]argins?\b",
     "Strength over demand: above one the sphere withstands, below one it breaks."),
    ("modulus (Weibull)", r"\bmodulus\b.{0,40}\b(scale|mean|threshold)|[Ww]eibull",
     "How little a strength of this law scatters: the larger, the narrower; no relation to Young’s modulus."),
    ("paper", r"\bpaper\b",
     "W. K. Nowacki, Dynamic compression of a brittle spherical specimen, Engng. Trans. 42(3), 263–279, 1994: "
     "the theory that this model corrects; Roman numbers are those of the errata in the program’s documents."),
    ("PAWN", r"\bPAWN\b",
     "The largest gap between the distribution of a quantity and the same with an input known."),
    ("pilot sample", r"\bpilot\b",
     "A small first sample, from which the model, the way of computing and the validity are judged."),
    ("polynomial chaos", r"[Pp]olynomial chaos",
     "The answer written as a sum of polynomials of the inputs, of so many terms and such a degree; a surrogate."),
    ("profile likelihood", r"profile likelihood",
     "An interval of a fitted parameter that holds every value under which the tests are not too unlikely."),
    ("quantile", r"\bquantiles?\b",
     "The value that a given share of the rows stays below."),
    ("rank correlation (Spearman)", r"[Ss]pearman",
     "How far two numbers rise together, from −1 to 1, judged by their order alone."),
    ("reliability index β", r"[Rr]eliability index",
     "A small probability as a number of standard deviations of the normal law: 2.3 is 1 %, 3.1 is 0.1 %."),
    ("Shapley effect", r"Shapley",
     "The share of the variance that belongs to an input; they sum to one even where inputs depend on each other."),
    ("surrogate", r"\bsurrogate",
     "A formula fitted to some evaluations of the model, that answers in its place."),
    ("a/r", r"\ba/r\b", "Radius of the contact circle over that of the sphere."),
    ("p, p_max, p_0", r"\bp_max\b|\bp_0\b",
     "Contact pressure in the centre of the circle: p_0 at any instant, p_max the largest of both faces. P is a force: "
     "P_0 the force scale, P_max the largest force. A lone p in a fit of tests is the probability of a worse fit."),
    ("t_c, θ", r"\bt_c\b|\bθ\b|\btheta\b",
     "Time scale of the contact, and the time t_i for which the pulse lasts over it."),
    ("Z, v_0, c_0", r"\bv_0\b|\bc_0\b",
     "Impedance of a bar (force over the speed of its end), the speed that the pulse brings, the speed of waves in the "
     "bar."),
)  # fmt: skip

_TAG: Final = re.compile(r"<style>.*?</style>|<[^>]*>", re.DOTALL)


def words_used(page: str) -> list[tuple[str, str]]:
    """The entries of the glossary that the text of a page (HTML, without drawings) asks for, in their order."""
    text = re.sub(r"\s+", " ", html.unescape(_TAG.sub(" ", page)))
    return [(word, meaning) for word, found, meaning in GLOSSARY if re.search(found, text)]


#: bytes that the figures of a page take up, which is never larger than 1 MB; what is beyond stays a file of its own
MOST_INLINED: Final = 550_000
#: what a page says that is written before the run is over
GOES_ON: Final = (
    "The run goes on: curves, drivers and the evidence are still to come, and this page is replaced then. If the run "
    "has ended without, run it again: what was evaluated is kept."
)
#: characters of one text on the page; a study may hold megabytes
LONGEST: Final = 1500


def build_report(folder: Path, threads: int | None = None) -> Path:
    """Write figures/*.svg and report.html of a finished run and of its services, from what is stored there.

    Parameters
    ----------
    folder : result folder of `uqsphere.run`
    threads : processors that may draw; all if None

    Returns
    -------
    Path
        The page.

    Raises
    ------
    FolderError
        When the folder holds no finished run, or is damaged.
    AccessError
        When a file cannot be written.
    """
    contents = read_contents(folder)
    for name in contents.services:
        build_report(folder / "services" / name, threads)
    with reading_units(units_of(contents.results, courses=contents.courses)):
        return _build(folder, contents, threads)


def _build(folder: Path, contents: Contents, threads: int | None) -> Path:
    """The figures and the page, in the units of the run; chapters are drawn by two processors, the longest first."""
    from threadpoolctl import threadpool_limits

    parts = CHAPTERS if "" in contents.parts else ()
    order = sorted(range(len(parts)), key=lambda k: parts[k][0] != "scene")
    with threadpool_limits(limits=1, user_api="blas"):  # of two processes, whose threads would keep each other waiting
        made = shared_out(lambda k: _drawn(build_chapters(contents, parts[k : k + 1])), order, copied=may_copy(threads))
        chapters = _distinct([*_drawn(service_chapters(contents)), *(chapter for part in made for chapter in part)])
    shown = _shown(contents)
    files = dict[str, str]()
    for picture in (block.picture for block in _blocks(chapters) if block.picture is not None):
        if picture.header:
            files[f"figures/{picture.name}.csv"] = csv_text(picture.header, picture.rows)
        files[f"figures/{picture.name}.svg"] = picture.svg
    files["report.html"] = _page(shown, chapters)
    for name, text in files.items():
        write_atomically(folder / name, text)
    write_sums(folder, list(files), keep=True)
    return folder / "report.html"


def _drawn(chapters: Sequence[Chapter]) -> list[Chapter]:
    """The same chapters, every picture drawn."""

    def drawn(block: Block) -> Block:
        picture = block.picture
        return replace(block, picture=picture and replace(picture, svg=render(picture), figure=None))

    return [replace(chapter, blocks=tuple(map(drawn, chapter.blocks))) for chapter in chapters]


def _blocks(chapters: Sequence[Chapter]) -> Iterator[Block]:
    for chapter in chapters:
        yield from chapter.blocks


def _distinct(chapters: Sequence[Chapter]) -> list[Chapter]:
    """The same chapters, their pictures with names that do not fall together where files cut them."""
    taken: set[str] = set()
    found = []
    for chapter in chapters:
        blocks = []
        for block in (block for block in chapter.blocks if not block.empty):
            if block.picture is not None:
                own = block.picture.name
                name = next(n for k in range(1, len(taken) + 2) if (n := own if k == 1 else f"{own}-{k}") not in taken)
                taken.add(name)
                block = replace(block, picture=replace(block.picture, name=name))
            blocks.append(block)
        found.append(replace(chapter, blocks=tuple(blocks)))
    return found


def _plain(value: Any) -> Any:
    """What a template sets: no control characters, and not endless; drawings pass as they are."""
    if type(value) is not str:
        return value
    return unbroken(shorten(value, LONGEST))


def _loose(value: str) -> str:
    """A cell of a table of very many columns: its intervals may part after their "to", so that no column is cut off."""
    from markupsafe import Markup, escape

    return Markup(escape(_plain(value).replace("\u00a0to\u00a0", "\u00a0to ")))


#: what sets a picture into the page that is being made
DRAW: Final[ContextVar[Callable[[Picture], str]]] = ContextVar("drawing of the page")


@cache
def page_environment() -> Environment:
    """Templates that escape every text and refuse what is not there, with what all pages share; compiled once."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=FunctionLoader(_own_text), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, finalize=_plain,
    )  # fmt: skip
    environment.globals["style"] = Markup(_own_text("style.css"))
    environment.globals["brief_style"] = Markup(_own_text("brief.css"))
    environment.globals["panel_style"] = Markup(_own_text("whatif.css"))
    environment.filters["loose"] = _loose
    # macros keep the filters that they were loaded with
    environment.filters["drawn"] = lambda picture: DRAW.get()(picture)
    return environment


def _own_text(name: str) -> str:
    return resources.files("uqsphere.report").joinpath(name).read_text("utf-8")


def _shown(contents: Contents) -> Fields:
    """What the page shows beside its chapters."""
    from markupsafe import Markup, escape

    return {
        "margin_boxes": Markup(margin_boxes(str(contents.results.study.title), contents.manifest)),
        "repeat": repeat_rows(contents),
        "commands": [Markup(escape(shorten(line, LONGEST))) for line in commands(contents)],
        "version": contents.results.versions.get("uqsphere", ""),
        "black_box": contents.black_box,
        **_brief_parts(contents),
        **_panel_parts(contents),
    }


def _page(shown: Mapping[str, object], chapters: Sequence[Chapter]) -> str:
    """The text of the page; the figures that it has no room for stay files."""
    from markupsafe import Markup

    room = MOST_INLINED

    def drawn(picture: Picture) -> str:
        nonlocal room
        element = inline(picture.svg, picture.name)
        room -= len(element.encode())
        if room < 0:
            return f"The figure is in figures/{picture.name}.svg: the page would become too large with it."
        # the one text that is not escaped: made of escaped parts by the XML writer
        return Markup(element)

    # set first without figures, to see which words are used
    plain = set_page(shown, chapters, lambda picture: picture.title)
    return set_page({**shown, "words": words_used(plain)}, chapters, drawn)


#: what a page has that no run stands behind
_NO_RUN: Final[Fields] = {
    "kind": "report", "version": "", "margin_boxes": "", "curves": (), "modes": (), "panels": (), "script": "",
    "policy": "", "repeat": (), "commands": (), "words": (), "black_box": False, "two": two,
}  # fmt: skip


def set_page(shown: Mapping[str, object], chapters: Sequence[Chapter], draw: Callable[[Picture], str]) -> str:
    """The text of a page: its brief and the evidence behind it, whatever it is of; `draw` sets its pictures."""
    environment = page_environment()
    DRAW.set(draw)
    pictures = [block.picture.name for block in _blocks(chapters) if block.picture is not None]
    more = {"chapters": chapters, "numbers_of": _numbers_of, "linked": True}
    numbers = {name: k for k, name in enumerate(pictures, 1)}
    template = environment.get_template("template.html")
    return template.render({**_NO_RUN, **more, **shown}, figure_numbers=numbers) + "\n"


# --- The brief: one sheet, on top of the page and a page of its own.


def _brief_parts(contents: Contents, ended: str | None = None) -> Fields:
    """What the template of the brief shows; `ended`: in place of how the run ended."""
    from markupsafe import Markup

    brief, modes = make_brief(contents), []
    for answer in brief.answers:
        texts = ["" if mode.miss is None else short_share(mode.miss, answer.target) for mode in answer.modes]
        dots = [Markup(mode_dots(mode, answer)) for mode in answer.modes]
        modes += [(answer, list(zip(answer.modes, dots, texts, strict=True)))] if texts else []
    curves = [[Markup(drawing) for drawing in one] for one in curve_drawings(brief.answers)]
    brief = brief if ended is None else replace(brief, ended=ended)
    return {"two": two, "title": brief.title, "brief": brief, "curves": curves, "modes": modes}


def _panel_parts(contents: Contents) -> Fields:
    """The what-if panels and their script, which the page's policy knows by its hash: no other one runs."""
    from markupsafe import Markup

    # no text of a study may end the element that holds it
    found = [replace(one, data=Markup(one.data.replace("<", "\\u003c"))) for one in panels(contents)]
    script = _own_text("whatif.js") if any(one.data for one in found) else ""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    return {
        "panels": found,
        "script": Markup(script),
        "policy": Markup(f"; script-src 'sha256-{digest}'") if script else "",
    }


def load_page() -> None:
    """What a page takes long to load: checks, templates, and a first drawing with what drawings need."""
    for document in (Results, Manifest):
        document.model_rebuild()
    for name in ("brief.html", "brief_body.html", "parts.html", "template.html", "whatif.html"):
        page_environment().get_template(name)
    figure, axes = new_figure(1.0)
    axes[0].plot([0.0, 1.0], label="$x$")
    legend_above(axes[0], 1)
    render(Picture(name="first", title="", figure=figure))


def build_and_sum_up(folder: Path, threads: int | None, width: int) -> tuple[Path, str]:
    """The page of a finished run, and what a terminal of so many columns says of it."""
    return build_report(folder, threads), summary_of(read_contents(folder), width)


def write_draft(folder: Path, known: Fields | Results, about: Fields | Manifest) -> None:
    """Write report.html of a run that goes on: the brief of what is known; nothing where a finished run is stored."""
    if (folder / "results.json").exists():
        return
    results, manifest = Results.model_validate(known), Manifest.model_validate(about)
    contents = Contents(results=results, manifest=manifest, resolved=read_resolved(folder), samples={}, failed=0.0)
    with reading_units(units_of(results)):
        shown = _brief_parts(contents, GOES_ON)
    text = page_environment().get_template("brief.html").render(shown, linked=False)
    write_atomically(folder / "report.html", text + "\n", durable=False)


def build_brief(folder: Path, *, pdf: bool = False) -> Path:
    """Write the brief of a folder as brief.html, or as one sheet of paper, brief.pdf.

    Raises
    ------
    UsageError
        Where the extra for PDF is missing.
    AccessError
        When the file cannot be written.
    """

    contents = read_contents(folder)
    with reading_units(units_of(contents.results)):
        shown = _brief_parts(contents)
    text = page_environment().get_template("brief.html").render(shown, linked=False)
    path = folder / "brief.html"
    if not pdf:
        write_atomically(path, text + "\n")
        return path
    check_pdf()
    path = folder / "brief.pdf"
    write_atomically(path, _printed(*on_one_sheet(text)))
    return path


def _numbers_of(block: Block) -> tuple[str, ...]:
    """The files that hold the numbers of the picture of a block."""
    assert block.picture is not None
    return (f"figures/{block.picture.name}.csv",) if block.picture.header else block.files


# --- The page as a typeset document, by WeasyPrint, which is an optional extra.

_LACKING: Final = "the PDF needs the extra: pip install 'uqsphere[pdf]'"
#: page numbers, and what the screen alone needs left out
_SHEET: Final = """
@page { size: A4; margin: 16mm 15mm 18mm;
  @bottom-right { content: counter(page) " / " counter(pages); font: 8pt "DejaVu Sans", sans-serif; } }
:root { color-scheme: light; }
html, body { background: #ffffff; color: #000000; }
.skip { display: none; }
nav a::after { content: " " target-counter(attr(href), page); }
/* the typesetter parts a floating figure from its caption */
figure { float: none; }
.scroll, .drawing { overflow: visible; }
/* beside a figure that floats all the same a table would go to the next page as a whole */
.scroll { clear: both; }
figure svg { min-width: 0; max-width: 100%; width: 165mm; }
table { font-size: 8pt; }
th, td { min-width: 0 !important; padding-right: 6pt; overflow-wrap: anywhere; }
"""


def check_pdf() -> None:
    """Refuse before anything is written where the extra, or a library of the system that it needs, is missing.

    Raises
    ------
    UsageError
        With what to install.
    """
    try:
        _load_weasyprint()
    except ImportError as error:
        raise UsageError(_LACKING) from error
    except OSError as error:
        raise UsageError(
            f"the PDF needs Pango, a library of the system that WeasyPrint sets texts with: {error}"
        ) from error


def build_pdf(folder: Path, *, full: bool = False) -> Path:
    """Typeset report.html of a folder as report.pdf, with its annexes where it is `full`; nothing is fetched.

    Raises
    ------
    UsageError
        Where the extra is missing.
    AccessError
        When the file cannot be written.
    """
    check_pdf()
    path = folder / "report.pdf"
    text = on_paper((folder / "report.html").read_text(encoding="utf-8"))
    if full:
        text = text.replace('<details class="annex">', '<details class="annex" open>')
    write_atomically(path, _printed(typeset(text)))
    return path


def _load_weasyprint() -> None:
    """Import WeasyPrint; it warns of system libraries that its next version needs, while fontTools does their work."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import weasyprint  # noqa: F401


def _printed(document: Document, zoom: float = 1.0) -> bytes:
    """A document as PDF; the typesetter's remarks on styles of the screen are nobody's business."""
    log = logging.getLogger("weasyprint")
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        buffer = io.BytesIO()
        document.write_pdf(buffer, zoom=zoom, uncompressed_pdf=False)
    finally:
        log.setLevel(before)
    return buffer.getvalue()


def typeset(text: str, sheet: str = _SHEET) -> Document:
    """The page laid out on paper, a `weasyprint.Document`: chapters in the list on the first pages have their page."""
    _load_weasyprint()
    from weasyprint import CSS, HTML
    from weasyprint.urls import URLFetcher

    # nothing of a page lies outside it: its pictures are data of its own
    inside = URLFetcher(allowed_protocols=("data",))
    return HTML(string=text, url_fetcher=inside, media_type="print").render(stylesheets=[CSS(string=sheet)])


def on_one_sheet(text: str) -> tuple[Document, float]:
    """The brief laid out, and the zoom that it is printed with to stand on one sheet of A4 whatever fonts there are.

    What is too long is laid out on paper larger by tenths of A4.
    """
    for tenths in range(10, 15):
        document = typeset(text.replace("size: A4;", f"size: {21 * tenths}mm {29.7 * tenths:.4g}mm;"), "")
        if len(document.pages) == 1:
            break
    return document, 10.0 / tenths
