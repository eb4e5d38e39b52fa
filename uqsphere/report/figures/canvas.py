"""One style for every figure, and the way from a drawing to SVG text.

Colours are those of Okabe and Ito (2008), told apart by colour-blind readers; marks, hatches and line styles
differ too, so that the figures can be read in grey.  Texts stay texts in the SVG.  Matplotlib's settings are
changed inside `style` alone and put back after it.
"""

from __future__ import annotations

import contextlib
import io
import math
import re
import textwrap
import unicodedata
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# --- Paths of an SVG without what nobody sees: digits beyond a hundredth of a point, and corners flatter than that.

#: corners below which a piece stays as it is
_FEWEST: Final = 8
_NUMBER: Final = re.compile(r"-?\d+\.\d{3,}")
_PIECE: Final = re.compile(r"M[^Mz]*z?")


def slim(path: str) -> str:
    """The `d` of a path with as few numbers as look the same.

    Parameters
    ----------
    path : the text of a `d`, coordinates in points; what has curves loses digits alone

    >>> slim("M 0 0 \\nL 1 0.001234 \\nL 2 0 \\nL 3 0 \\nL 4 0 \\nL 5 0 \\nL 6 0 \\nL 7 0 \\nL 8 5 \\nz")
    'M0 0L7 0 8 5z'
    """
    if not set(re.findall(r"[A-Za-z]", path)) <= set("MLz") or (len(path) < 120 and path.count("L") < _FEWEST):
        return _NUMBER.sub(lambda number: f"{float(number[0]):.2f}", path)
    return "".join(_piece(text) for text in _PIECE.findall(path))


def _piece(text: str) -> str:
    end = "z" if text.endswith("z") else ""
    points = np.array(re.findall(r"-?[\d.]+(?:e-?\d+)?", text), dtype=float).reshape(-1, 2)
    if len(points) >= _FEWEST:
        points = points[_corners(points)]
    texts = [f"{_short(x)} {_short(y)}" for x, y in points]
    return f"M{texts[0]}" + (f"L{' '.join(texts[1:])}" if len(texts) > 1 else "") + end


def _short(value: float) -> str:
    return f"{round(value, 2) + 0.0:.2f}".rstrip("0").rstrip(".")


def _corners(points: Array) -> npt.NDArray[np.bool_]:
    """Which points (n, 2) to keep so that no other is further from the line than is seen (Douglas and Peucker 1973)."""
    kept = np.zeros(len(points), dtype=bool)
    kept[[0, -1]] = True
    open_parts = [(0, len(points) - 1)]
    while open_parts:
        first, last = open_parts.pop()
        if last - first < 2:
            continue
        inner, start = points[first + 1 : last], points[first]
        along = points[last] - start
        length = float(np.hypot(*along))
        # a piece that ends where it began is measured from there
        if length > 1e-9:
            share = np.clip((inner - start) @ along / length**2, 0.0, 1.0)
            away = np.hypot(*(inner - start - share[:, None] * along).T)
        else:
            away = np.hypot(*(inner - start).T)
        worst = int(np.argmax(away))
        # corners that lie nearer to a straight line than this [pt] are left out
        if away[worst] > 0.04:
            middle = first + 1 + worst
            kept[middle] = True
            open_parts += [(first, middle), (middle, last)]
    return kept


INK: Final = "#1b1f24"
#: ink and paper that no theme turns round: for what lies on colours that stay light on a dark page
ON_LIGHT: Final = "#1a1e23"
LIGHT: Final = "#fefefe"
GREY: Final = "#6b7280"
FAINT: Final = "#d6d9de"
PAPER: Final = "#ffffff"
BLUE: Final = "#0072b2"
ORANGE: Final = "#e69f00"
GREEN: Final = "#009e73"
RED: Final = "#d55e00"
#: the same dark enough for letters: 6.6 to 1 on paper
WARM: Final = "#a33b00"
PURPLE: Final = "#cc79a7"
SKY: Final = "#56b4e9"
MARKS: Final = "osD^vP"

#: colours that the page replaces by its own, so that figures follow a dark theme
_THEME: Final = {INK: "ink", GREY: "soft", FAINT: "line", PAPER: "paper", BLUE: "blue", WARM: "bad"}
_WIDTH: Final = 6.4
_FACE: Final = "'DejaVu Sans', Verdana, sans-serif"
_BIDI: Final = frozenset("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
_SVG: Final = "{http://www.w3.org/2000/svg}"
_XLINK: Final = "{http://www.w3.org/1999/xlink}"

_SETTINGS: Final[dict[str, Any]] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "uqsphere",
    "text.parse_math": False,
    "text.usetex": False,
    "font.family": ["DejaVu Sans"],
    "font.size": 10.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 10.0,
    "xtick.labelsize": 9.0,
    "ytick.labelsize": 9.0,
    "legend.fontsize": 9.0,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.titlelocation": "left",
    "text.color": INK,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.unicode_minus": True,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "hatch.linewidth": 0.8,
    "grid.color": FAINT,
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "lines.linewidth": 1.6,
    "axes.formatter.useoffset": False,
    "axes.formatter.use_mathtext": False,
    "path.simplify": True,
}
#: settings of the machine, not of a picture
_MACHINE: Final = (
    "backend", "interactive", "toolbar", "webagg", "tk.", "savefig.directory", "date.", "timezone", "docstring",
    "keymap", "animation", "macosx", "figure.hooks", "_internal",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A drawing with the words that stand for it.

    `name` serves as file name and anchor; `title` says what is drawn, `finding` what it shows, where no table beside it
    does; `svg` is the `figure` once it is drawn, in its place; `header` and `rows` are the numbers that were drawn, in
    SI, where no table of the run holds them.
    """

    name: str
    title: str
    finding: str = ""
    figure: Figure | None = None
    svg: str = ""
    header: tuple[str, ...] = ()
    rows: tuple[tuple[object, ...], ...] = ()


#: what no XML may hold, as UTF-8: a name in a figure may come from a stranger's folder
_NO_XML = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]|\xef\xbf[\xbe\xbf]")


#: an apostrophe as it is typed
APOSTROPHE: Final = re.compile(r"(?<=[A-Za-z])'(?=[a-z]|$| )")
#: spaces that a line may break at; those within numbers stay as they are
_SPACES: Final = re.compile(r"[^\S\u00a0\u202f]+")


def clean(text: str) -> str:
    """A text of a study as it may stand in a figure: no control characters, on one line.

    >>> clean("a\\x00b\\nc")
    'ab c'
    """
    kept = "".join(
        " " if c in "\t\n\r" else c
        for c in text
        if c in "\t\n\r" or (unicodedata.category(c) not in ("Cc", "Cs", "Cn", "Co") and c not in _BIDI)
    )
    return _SPACES.sub(" ", kept).strip()


def shorten(text: str, length: int) -> str:
    """At most `length` characters; what is too long loses its middle.

    >>> shorten("a_very_long_name_of_an_input", 15)
    'a_very_…n_input'
    """
    text = clean(text)
    if len(text) <= length:
        return text
    front = (length - 1) // 2
    return text[:front] + "…" + text[len(text) - (length - 1 - front) :]


def wrap(text: str, width: int, lines: int = 2) -> str:
    """At most `lines` lines of `width` characters; what is too long loses its middle."""
    found = textwrap.wrap(clean(text), width)
    if len(found) > lines:
        found = textwrap.wrap(shorten(text, width * lines - lines), width)[:lines]
    return "\n".join(found)


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Matplotlib in the report's style, whatever the user's own settings are."""
    import matplotlib

    with warnings.catch_warnings():
        # a sign that the measuring font lacks is drawn by the reader's own font
        warnings.filterwarnings("ignore", message=r"Glyph \d+ .* missing from")
        warnings.filterwarnings("ignore", message=r".*does not support .* natively")
        warnings.simplefilter("ignore", matplotlib.MatplotlibDeprecationWarning)
        settings: dict[Any, Any] = {
            key: value for key, value in matplotlib.rcParamsDefault.items() if not key.startswith(_MACHINE)
        }
        with matplotlib.rc_context(settings | _SETTINGS):
            yield


def new_figure(height: float, rows: int = 1, **keywords: Any) -> tuple[Figure, list[Axes]]:
    """A figure of the one width and `height` [in], with `rows` axes one above the other."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, height), layout="constrained")
    # the canvas measures texts; what is written is SVG
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, 1, squeeze=False, **keywords)
    return figure, [row[0] for row in axes]


def legend_above(axes: Axes, columns: int, handles: Iterable[Artist] | None = None, line: float = 2.0) -> None:
    """What each mark is, in columns above the drawing; `line` is the length of a mark."""
    axes.legend(
        handles=axes.get_legend_handles_labels()[0] if handles is None else handles, loc="lower left", ncols=columns,
        bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2, borderpad=0.0, handlelength=line, columnspacing=1.2,
    )  # fmt: skip


def frame(axes: Axes, *, x: str = "", y: str = "", grid: bool = False, legend: int = 0) -> None:
    """What stands around a drawing: names of its axes, a grid, a legend above in so many columns."""
    if x:
        axes.set_xlabel(x)
    if y:
        axes.set_ylabel(y)
    if grid:
        axes.grid()
    if legend:
        legend_above(axes, legend)


def mark(colour: str, label: str, **line: Any) -> Artist:
    """A line or a mark as a legend shows it."""
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, label=label, **line)


def note(axes: Axes, words: str, at: tuple[float, float], by: tuple[float, float] = (0.0, 0.0), **more: Any) -> None:
    """Words at a place, moved `by` points; `more` goes to matplotlib."""
    axes.annotate(words, at, xytext=by, textcoords="offset points", **{"fontsize": 9.0, **more})


def band(axes: Axes, x: Array, low: Array, high: Array, colour: str, alpha: float = 0.25, **more: Any) -> None:
    """What lies between two curves, pale and without an edge."""
    axes.fill_between(x, low, high, color=colour, alpha=alpha, linewidth=0.0, **more)


def time_unit(longest: float) -> tuple[str, float]:
    """The unit in which times up to `longest` [s] read well, and its factor."""
    return ("ms", 1e3) if longest >= 2e-3 else ("µs", 1e6)


def log_axis(axes: Axes, which: str, low: float, high: float) -> None:
    """A logarithmic axis, x or y, from low to high with plain numbers at it, as many as there is room for."""
    getattr(axes, f"set_{which}scale")("log")
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    span = math.log10(high / low)
    steps = (1.0,) if span > 2.6 else (1.0, 2.0, 5.0) if span > 0.7 else (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
    ticks = [step * 10.0**k for k in decades for step in steps if low <= step * 10.0**k <= high]
    getattr(axes, f"set_{which}ticks")(ticks, [f"{tick:.6g}" for tick in ticks])
    getattr(axes, f"set_{which}ticks")([], minor=True)
    getattr(axes, f"set_{which}lim")(low, high)


def score(p: npt.ArrayLike, least: float = 1e-6) -> Array:
    """Normal scores of probabilities, which are kept `least` away from 0 and 1."""
    from scipy.special import ndtri

    return np.asarray(ndtri(np.clip(np.asarray(p, dtype=float), least, 1.0 - least)))


def name_rows(axes: Axes, names: Sequence[str], top: float = -0.5, bottom: float = -0.5) -> None:
    """Rows with their names in place of an axis, from the top; `top` and `bottom` are the room beyond them."""
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) + bottom, top)
    axes.tick_params(axis="y", length=0)


def spread(wanted: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """Positions as near as possible to those wanted, at least `gap` apart, between low and high if there is room.

    >>> spread([1.0, 1.1, 5.0], 1.0, 0.0, 10.0)
    [0.55, 1.55, 5.0]
    """
    order = sorted(range(len(wanted)), key=lambda k: wanted[k])
    blocks: list[tuple[float, list[int]]] = []  # centre of a block and its members, in order
    for k in order:
        centre, members = min(max(wanted[k], low), high), [k]
        while blocks and blocks[-1][0] + 0.5 * gap * len(blocks[-1][1]) > centre - 0.5 * gap * len(members):
            before, others = blocks.pop()
            centre = (before * len(others) + centre * len(members)) / (len(others) + len(members))
            members = others + members
            half = 0.5 * gap * (len(members) - 1)
            centre = max(low + half, min(centre, high - half))
        blocks.append((centre, members))
    positions = [0.0] * len(wanted)
    for centre, members in blocks:
        for place, k in enumerate(members):
            positions[k] = centre + gap * (place - 0.5 * (len(members) - 1))
    return positions


def render(picture: Picture) -> str:
    """The picture as the text of an SVG file, the same for the same picture, on white."""
    if picture.figure is None:
        return picture.svg
    buffer = io.BytesIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with style():
        engine = picture.figure.get_layout_engine()
        if engine is not None:
            # laid out once and not again: drawing would do it twice over
            engine.execute(picture.figure)
            picture.figure.set_layout_engine(None)
        picture.figure.savefig(buffer, format="svg", metadata=nothing)
    root = ElementTree.fromstring(_NO_XML.sub(b"", buffer.getvalue()))
    _plain(root, set(re.findall(r"(?:url\(#|href=\"#)([\w-]+)", buffer.getvalue().decode("utf-8"))))
    _describe(root, picture)
    ElementTree.register_namespace("", _SVG[1:-1])
    ElementTree.register_namespace("xlink", _XLINK[1:-1])
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _plain(element: ElementTree.Element, asked: set[str]) -> None:
    """What is drawn alone: no groups without a say, no names that nothing in `asked` calls, no blanks between tags."""
    element.tail = None
    if element.get("id") not in asked:
        element.attrib.pop("id", None)
    _short_attributes(element)
    if element.tag in (f"{_SVG}text", f"{_SVG}tspan"):
        element.text = APOSTROPHE.sub("’", element.text or "")
    elif not (element.text or "").strip():
        element.text = None
    kept: list[ElementTree.Element] = []
    for child in element:
        _plain(child, asked)
        # metadata, a style sheet that would reach beyond the figure, and empty parts draw nothing
        idle = child.tag in (f"{_SVG}metadata", f"{_SVG}style") or (child.tag == f"{_SVG}defs" and not len(child))
        idle |= child.tag == f"{_SVG}path" and child.get("style") == "fill: none" and "id" not in child.attrib
        bare = child.tag == f"{_SVG}g" and not child.attrib
        kept += list(child) if bare else [] if idle else [child]
    element[:] = kept


def _short_attributes(element: ElementTree.Element) -> None:
    """Style, places and paths with what is seen alone."""
    if found := element.get("style"):
        # the reader's machine may lack the font that was measured with; it is wide, so others fit
        element.set("style", found.replace("font-family: 'DejaVu Sans'; ", "").replace("'DejaVu Sans'", _FACE))
    if element.get("transform", "").startswith("rotate(-0 "):
        del element.attrib["transform"]
    for key in ("x", "y", "transform"):
        if key in element.attrib:
            element.set(key, _NUMBER.sub(lambda number: _short(float(number[0])), element.attrib[key]))
    if "d" in element.attrib:
        element.set("d", slim(element.attrib["d"]))


def _describe(root: ElementTree.Element, picture: Picture) -> None:
    """Words for who does not see the picture, and the paper it stands on."""
    parts = [(kind, text) for kind, text in (("title", picture.title), ("desc", picture.finding)) if text]
    root.attrib |= {
        "role": "img",
        "id": "root",
        "aria-labelledby": " ".join(kind for kind, _ in parts),
        "style": f"stroke-linejoin: round; stroke-linecap: butt; font-family: {_FACE}",
    }
    for place, (kind, text) in enumerate(parts):
        element = ElementTree.Element(f"{_SVG}{kind}", {"id": kind})
        element.text = APOSTROPHE.sub("’", clean(text))
        root.insert(place, element)
    paper = ElementTree.Element(f"{_SVG}rect", {"id": "paper", "width": "100%", "height": "100%", "fill": PAPER})
    root.insert(len(parts), paper)


def inline(svg: str, name: str) -> str:
    """The text of a rendered SVG as an element of an HTML page: ids made its own by `name`, the page's theme."""
    root = ElementTree.fromstring(svg)
    root.remove(next(child for child in root if child.get("id") == "paper"))
    for key in ("width", "height"):
        del root.attrib[key]
    for element in root.iter():
        element.tag = element.tag.removeprefix(_SVG)
        for key, value in list(element.attrib.items()):
            del element.attrib[key]
            element.set(key.removeprefix(_XLINK), _own(key.removeprefix(_XLINK), value, f"{name}-"))
    return ElementTree.tostring(root, encoding="unicode")


def _own(key: str, value: str, prefix: str) -> str:
    if key == "id":
        return prefix + value
    if key == "href":
        # pictures inside a drawing carry their data here
        return "#" + prefix + value[1:] if value.startswith("#") else value
    if key == "aria-labelledby":
        return " ".join(prefix + word for word in value.split())
    value = re.sub(r"url\(#", f"url(#{prefix}", value)
    if key == "style":
        for colour, name in _THEME.items():
            value = value.replace(colour, f"var(--{name}, {colour})")
    return value


def on_paper(text: str) -> str:
    """A page or drawing with the colours of paper, which a typesetter knows, in place of the theme's."""
    return re.sub(r"var\(--[a-z]+, (#[0-9a-f]{6})\)", r"\1", text)


def slug(*words: str) -> str:
    """A file name and anchor made of words."""
    text = "-".join(words).lower()
    return "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "-" for c in text)[:60].strip("-") or "figure"
