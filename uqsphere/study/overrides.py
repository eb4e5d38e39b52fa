"""Values set or taken out from outside the file: ``--set striker.speed.mean="0.6 m/s"``, ``--set margins=null``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final

from uqsphere.errors import UsageError
from uqsphere.study.findings import Place, render_place, shown, suggestion

__all__ = ["apply_overrides"]

#: what takes a value out; as a text it is written with its quotation marks
_NOTHING: Final = "null"
_PART = re.compile(r"""(?:([A-Za-z0-9_-]+)|"([^"\\]*)"|'([^']*)')((?:\[\d{1,6}\])*)(\.|$)""")


def apply_overrides(data: dict[str, Any], overrides: Sequence[str]) -> list[Place]:
    """Put each ``PATH=VALUE`` into `data`; the places that were set.

    VALUE is a TOML value; what is none (a bare quantity such as ``0.6 m/s``, a bare word) is a text.  The bare word
    ``null``, which TOML does not have, takes out what stands at the path: a value, a table or an item of a list.

    Raises
    ------
    UsageError
        Where there is no "=", the path is none, it leads through something that is not a table, or there is nothing
        to take out.

    >>> data = {"striker": {"speed": {"mean": "0.5 m/s"}}}
    >>> apply_overrides(data, ["striker.speed.mean=0.6 m/s"])
    [('striker', 'speed', 'mean')]
    >>> data
    {'striker': {'speed': {'mean': '0.6 m/s'}}}
    >>> apply_overrides(data, ["striker.speed=null"]), data
    ([('striker', 'speed')], {'striker': {}})
    """
    return [_apply(data, text) for text in overrides]


def _apply(data: dict[str, Any], text: str) -> Place:
    path, sign, value = text.partition("=")
    if not sign or not path.strip():
        raise UsageError(f"found {shown(text)}: PATH=VALUE is due, such as striker.speed=0.6 m/s")
    place = _split(path.strip(), text)
    taken_out = value.strip() == _NOTHING
    node: Any = data
    for depth, part in enumerate(place[:-1]):
        if isinstance(node, dict) and isinstance(part, str):
            if taken_out and part not in node:
                raise _nothing_there(place[: depth + 1], node, text)
            node = node.setdefault(part, {})
        elif isinstance(node, list) and isinstance(part, int) and part < len(node):
            node = node[part]
        else:
            raise _no_way(place[:depth], node, text)
    last = place[-1]
    usable = isinstance(node, dict) and isinstance(last, str)
    usable = usable or (isinstance(node, list) and isinstance(last, int) and last < len(node))
    if not usable:
        raise _no_way(place[:-1], node, text)
    if not taken_out:
        node[last] = _value(value.strip())
    elif isinstance(node, dict) and last not in node:
        raise _nothing_there(place, node, text)
    else:
        del node[last]
    return place


def _split(path: str, text: str) -> Place:
    place: list[str | int] = []
    at = 0
    while at < len(path):
        match = _PART.match(path, at)
        if match is None or (match.end() == len(path) and match.group(5) == "."):
            raise UsageError(f"found {shown(text)}: {shown(path)} is no path of a study, such as striker.speed.mean")
        place.append(next(part for part in match.groups()[:3] if part is not None))
        place += [int(index) for index in re.findall(r"\d+", match.group(4))]
        at = match.end()
    if len(place) > 8:
        raise UsageError(f"found {shown(text)}: the path is longer than any of a study")
    return tuple(place)


def _no_way(place: Place, node: object, text: str) -> UsageError:
    where = render_place(place) or "the study"
    return UsageError(f"found {shown(text)}, but {where} is {shown(node)}: set {where} itself")


def _nothing_there(place: Place, node: dict[str, Any], text: str) -> UsageError:
    there = sorted(str(key) for key in node)
    hint = suggestion(str(place[-1]), there) or (f"; there is {', '.join(there[:20])}" if there else "")
    return UsageError(f"found {shown(text)}, but there is no {render_place(place)} to take out{hint}")


def _value(text: str) -> Any:
    import tomllib

    # More than this is no value of a study, and could be nested too deeply to read.
    if len(text) <= 4096 and text.count("[") + text.count("{") <= 16 and "\n" not in text:
        try:
            return tomllib.loads(f"value = {text}")["value"]
        except (ValueError, RecursionError, OverflowError):
            pass
    return text
