"""From a TOML file, a text or a dict to a `Study`, with faults at their lines."""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from uqsphere.documents import (
    Fault,
    above,
    located,
    parse_text,
    read_text,
    refusal,
    set_value,
    toml_text,
)
from uqsphere.uq.foreign import law_table

from .check import BOX_STAGES, STAGES, resolve
from .study import Draft, Study


def load_study(
    path: str | Path | Mapping[str, object] = "study.toml",
    overrides: Sequence[str] = (),
    *,
    text: str | None = None,
) -> Study:
    """Read and validate a study: a TOML file, its text, or its tables as a mapping.

    Parameters
    ----------
    path : path-like or mapping
        The file; no file outside its folder is read.  With `text`, the name and the folder that
        messages and data files refer to.  A mapping holds the tables themselves:
        ``{"inputs": {"x": {"dist": "normal", "mean": 0, "sd": 1}}, ...}``.
    overrides : sequence of str
        ``PATH=VALUE`` each, such as ``striker.speed.mean=0.6 m/s``, applied before validation.
    text : str, optional
        Content of a study file, instead of reading one.

    Returns
    -------
    Study
        The study in SI units, with defaults and library values filled in.

    Raises
    ------
    StudyError
        Lists every error of the first stage of `uqsphere.study.check.STAGES` that has one, each
        with its line.
    AccessError
        The file is missing or cannot be read.
    UsageError
        An override cannot be applied, or a value cannot be written to a study file.

    Examples
    --------
    >>> inputs = {"x": {"dist": "normal", "mean": 0.0, "sd": 1.0}}
    >>> load_study({"title": "Two tables", "inputs": inputs, "outputs": {"names": ["y"]}})
    <Study 'Two tables': 1 random input, black box>
    """
    tables = None
    name = ""
    if isinstance(path, Mapping):
        tables = path
        text = toml_text(path, law_table)
        path = "study.toml"
    path = Path(path)
    if isinstance(overrides, str):
        overrides = (overrides,)
    if text is None:
        text = read_text(path)
    data = parse_text(text, path)
    overridden = [set_value(data, override) for override in overrides]
    if tables is None:
        tables = data
        name = path.name
    draft = Draft(path.parent, data, not data.keys().isdisjoint(("inputs", "outputs")))
    for stage in BOX_STAGES if draft.box else STAGES:
        faults = list[Fault]()
        for check in stage:
            try:
                faults += check(draft) or ()
            except Fault as fault:  # behind those that the check has yielded
                faults.append(fault)
        if faults:
            if draft.scene is not None:
                faults += [*_doubts(draft, faults)]
            at_keys = [Fault(str(fault), _written(fault.key, tables)) for fault in faults]
            raise refusal(path, text, at_keys, overridden)
    notes = [Fault(message, _written(place, tables)) for place, message in draft.warnings]
    warnings = tuple(
        note.render(name if note.path else "") for note in located(text, notes, overridden)
    )
    return resolve(draft, path, text=text, overrides=tuple(overrides), warnings=warnings)


def _written(path: str, tables: object) -> str:
    """A place as far as it was written: a number or a distribution of SciPy has no further keys."""
    for part in re.finditer(r"[^.\[\]]+", path):
        if isinstance(tables, Mapping):
            tables = tables.get(part[0], {})
        elif isinstance(tables, list | tuple) and part[0].isdigit():
            tables = tables[int(part[0])]
        else:
            return path[: part.start() - 1]
    return path


def _doubts(draft: Draft, faults: list[Fault]) -> Iterator[Fault]:
    """Numbers whose unit seems wrong, since a refusal of the scene or of a limit may follow from
    them; a fault of the same number is told behind the doubt.
    """
    for (place, message), holds in draft.warnings.items():
        if holds != "unit":
            continue
        depth = 4 if place.startswith("limits.") else 3
        number = above(place)[-depth:][0]
        of_it = [fault for fault in faults if number in above(fault.key)]
        if not of_it:
            yield Fault(message, place)
        for fault in of_it:
            fault.args = (f"{message} As it is, {fault}",)
