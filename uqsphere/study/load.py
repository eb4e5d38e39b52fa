"""From a TOML file, a text or a dict to a `Study`, with faults at their lines."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from uqsphere.documents import (
    Fault,
    Place,
    parse_text,
    read_text,
    refusal,
    set_value,
    shown,
    toml_text,
)
from uqsphere.study.check import BOX_STAGES, STAGES, Faults, resolve
from uqsphere.study.document import Draft
from uqsphere.study.study import Study
from uqsphere.uq.foreign import law_table


def load_study(
    path: str | Path | Mapping[str, object] = "study.toml",
    overrides: Sequence[str] = (),
    *,
    text: str | None = None,
) -> Study:
    """The study of a TOML file, of such a text, or of the same tables as a dict, validated.

    path : the file; nothing outside its folder is read.  With a `text` what it is called, and where
    its data lie.  A mapping holds the tables themselves: ``{"inputs": {"x": {"dist": "normal",
    "mean": 0, "sd": 1}}, ...}``.
    overrides : ``PATH=VALUE`` each, such as ``striker.speed.mean=0.6 m/s``, put in place before
        anything is checked.
    text : the content of a study file, in place of reading one.

    Raises StudyError with every fault of the first of `STAGES` that has one, each with its line;
    AccessError where the file is missing or cannot be read; UsageError for an override that is
    none, and a value that no study file can hold.

    >>> inputs = {"x": {"dist": "normal", "mean": 0.0, "sd": 1.0}}
    >>> load_study({"title": "Two tables", "inputs": inputs, "outputs": {"names": ["y"]}})
    <Study 'Two tables': 1 random input, black box>
    """
    if isinstance(path, Mapping):
        text, path = toml_text(path, law_table), "study.toml"
    path = Path(path)
    text = read_text(path) if text is None else text
    data = parse_text(text, path)
    overridden = [set_value(data, one) for one in overrides]
    draft = Draft(
        folder=path.parent, data=data, box=not data.keys().isdisjoint(("inputs", "outputs"))
    )
    for stage in BOX_STAGES if draft.box else STAGES:
        faults: list[Fault] = []
        for check in stage:
            try:
                faults.extend(check(draft))
            except Fault as fault:  # behind those that the check has yielded
                faults.append(fault)
        if faults:
            raise refusal(path, text, [*_removed(draft.data, _ways_out())] or faults, overridden)
    return replace(resolve(draft, path, text), overrides=tuple(overrides))


# --- keys of earlier studies ----------------------------------------------------------------------


def _removed(node: Any, ways: Mapping[str, str], above: Place = ()) -> Faults:
    """Every key and value of an earlier study that is renamed or dropped, with the way out; a table
    by its keys.
    """
    for key, value in node.items() if isinstance(node, Mapping) else enumerate(node):
        place: Place = (*above, key)
        path, held = (
            ".".join(map(str, place)),
            "+".join(value) if isinstance(value, dict) else value,
        )
        for pattern, way in ways.items():
            if fnmatchcase(path, pattern) or fnmatchcase(f"{path}={held}", pattern):
                found = (
                    f"{shown(value)} is no longer allowed"
                    if "=" in pattern
                    else f"{key} is no longer a key"
                )
                yield Fault(f"{found}: {way}", *place)
                break
        else:
            if isinstance(value, dict | list) and len(place) < 6:
                yield from _removed(value, ways, place)


def _ways_out() -> dict[str, str]:
    ways = tomllib.loads(Path(__file__).with_name("removed.toml").read_text(encoding="utf-8"))
    return {pattern: way for way, patterns in ways.items() for pattern in patterns}
