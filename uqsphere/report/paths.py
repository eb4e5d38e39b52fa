"""Paths of an SVG without what nobody sees: digits beyond a hundredth of a point, and corners flatter than that."""

from __future__ import annotations

import re
from typing import Final

import numpy as np
import numpy.typing as npt

__all__ = ["slim"]

Array = npt.NDArray[np.float64]

#: corners that lie nearer to a straight line than this [pt] are left out
_FLAT: Final = 0.04
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
        if away[worst] > _FLAT:
            middle = first + 1 + worst
            kept[middle] = True
            open_parts += [(first, middle), (middle, last)]
    return kept
