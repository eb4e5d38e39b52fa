"""What a page carries so that its reader may move numbers and see the answers follow, without a run and without a net.

Rows of the sample go with it: for strengths, dependence and targets they are asked again, as a run would ask them.  For
speeds, sizes and stiffnesses the demands of these rows are moved by the surfaces of sliders.json, within what they
were fitted to.  `whatif.js` does the asking.
"""

from __future__ import annotations

import base64
import json
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import ndtri

from uqsphere.arrays import Array
from uqsphere.quantities import OUTPUTS, display_unit, reading_units
from uqsphere.report.brief import PLACES
from uqsphere.report.contents import Contents, law_of, stored_law, units_of
from uqsphere.report.figures.canvas import shorten
from uqsphere.report.phrases import short_input, unit_text
from uqsphere.results import Results, VerdictEntry
from uqsphere.results.entries import MarginEntry, SliderEntry, Sliders, SurfaceEntry
from uqsphere.study import strength_name
from uqsphere.uq import Law, LimitState, miss
from uqsphere.uq.joint import correlation_from_spearman
from uqsphere.uq.whatif import logit

#: characters of base64 that the rows of a page may take; the most rows that are asked again, and that are moved
_ROOM, _ASKED, _MOVED = 300_000, 16_384, 4096
#: share of rows whose demand may be a lower bound, and by how much the rows may be off the run in logits
_LATE, _OFF = 1e-3, 0.25
#: places at which another law is told, and how far beyond the demands, in ln
_PLACES, _BEYOND = 600, 0.8
#: normal score of what never happens
_NEVER: Final = 38.0
#: how the sliders are called
_CALLED: Final = {
    "striker.speed": "Striker speed", "rig.speed": "Speed", "rig.drop_height": "Drop", "hammer.speed": "Hammer speed",
    "hammer.drop_height": "Hammer drop", "sphere.radius": "Sphere radius", "bars.diameter": "Bar diameter",
    "target.thickness": "Plate thickness", "target.mass": "Mass of the target", "hammer.mass": "Hammer mass",
    "other.radius": "Radius of the other sphere", "rod.diameter": "Rod diameter", "sphere.E": "Stiffness of the sphere",
}  # fmt: skip
#: reasons of a verdict that rows cannot judge again, by their codes
_STAYS: Final = ("a", "b", "d", "e", "f")


@dataclass(frozen=True, kw_only=True)
class Panel:
    """What-if for a rig: its data as JSON, or why there is none."""

    name: str
    data: str = ""
    reason: str = ""


class _NotHere(Exception):
    """Why a study has no panel."""


def panels(contents: Contents) -> list[Panel]:
    """A panel for the study's own rig and for each of its services that has limits."""
    parts = {name: part for name, part in contents.parts.items() if part.results.limits}
    found = []
    for name, part in parts.items():
        with reading_units(units_of(part.results)):
            try:
                data = _data(part, name, _ROOM // len(parts))
            except _NotHere as why:
                found.append(Panel(name=name, reason=str(why)))
            else:
                found.append(Panel(name=name, data=json.dumps(data, separators=(",", ":"), allow_nan=False)))
    return found


def _data(contents: Contents, service: str, room: int) -> dict[str, object]:
    """The data of one panel.  Raises _NotHere."""
    results, sliders = contents.results, contents.sliders or Sliders(reason="the run is older than its sliders")
    names = [name for name, limit in results.limits.items() if limit.miss.value is not None]
    if not contents.points or not names:
        raise _NotHere("nothing is known of rows that scatter")
    columns = _scatter(contents, sliders)
    limits, why = [], ""
    for name in names:
        try:
            limits.append(_limit(contents, name, columns))
        except _NotHere as error:
            why = str(error)
    if not limits:
        raise _NotHere(why)
    scattered = set(contents.points)
    asked = [one for one in columns if one not in scattered]
    moved = [one for one in columns if one in scattered]
    # a value takes 8/3 characters
    share = min(1.0, 3 * room / 8 / (_ASKED * len(asked) + _MOVED * len(moved)))
    counts, kept = _kept(contents.replicates, int(_ASKED * share))
    few, few_kept = _kept(contents.replicates, int(_MOVED * share))
    return {
        "service": service,
        "counts": counts,
        "few": few,
        "asked": {name: _packed(columns[name][kept]) for name in asked},
        "moved": {name: _packed(columns[name][few_kept]) for name in moved},
        "limits": limits,
        **_moving(contents, sliders, service),
    }


def _moving(contents: Contents, sliders: Sliders, service: str) -> dict[str, object]:
    """What moves the demands, or why nothing does."""
    return {
        "axes": [[one.name, one.middle, one.half] for one in sliders.axes],
        "sliders": [_slider(contents, one, service) for one in sliders.sliders] if sliders.surfaces else [],
        "surfaces": {name: _surface(one) for name, one in sliders.surfaces.items()},
        "absent": sliders.reason or "; ".join(dict.fromkeys(sliders.rough.values())),
    }


# --- rows -----------------------------------------------------------------------------------------------------


def _kept(replicates: Array, most: int) -> tuple[list[int], Array]:
    """How many rows of each randomisation are taken, the first ones, and which they are."""
    numbers = np.unique(replicates)
    first = max(2, most // len(numbers))
    rows = [np.flatnonzero(replicates == number)[:first] for number in numbers]
    return [len(row) for row in rows], np.concatenate(rows)


def _packed(column: Array) -> list[object]:
    """A column (n,) as its least value, its step, and 16 bits a value, little end first."""
    low, high = float(column.min()), float(column.max())
    step = (high - low) / 65535.0 or 1.0
    whole = np.rint((column - low) / step).astype("<u2")
    return [low, step, base64.b64encode(whole.tobytes()).decode("ascii")]


def _scatter(contents: Contents, sliders: Sliders) -> dict[str, Array]:
    """Where the rows (n,) lie within the law of each input that a surface hangs on: its median 0, one spread 1.

    Of an input that has no slider the place on its axis.
    """
    found = {}
    moved = {one.name: one for one in sliders.sliders}
    for axis in sliders.axes:
        if axis.name not in contents.points or not sliders.surfaces:
            continue
        values = contents.points[axis.name]
        x = np.log(values) if axis.logarithm else values
        centre, spread = axis.middle, axis.half
        if axis.name in moved:
            one = moved[axis.name]
            at = one.nodes.index(one.base)
            centre, spread = one.centres[at], one.spreads[at]
        found[axis.name] = (x - centre) / spread
    return found


# --- limits ---------------------------------------------------------------------------------------------------


def _limit(contents: Contents, name: str, columns: dict[str, Array]) -> dict[str, object]:
    """A limit with its law, its answer and its verdict; its rows are entered among the columns.  Raises _NotHere."""
    results, entry = contents.results, contents.results.limits[name]
    law = law_of(contents.resolved, strength_name(name))
    if law is not None and law.is_steps:
        raise _NotHere("the strength steps from test to test")
    demands, tie = _demands(contents, name), _tie(contents, name)
    _check(contents, name, demands, law)
    positive = np.log(demands[demands > 0.0])
    columns[f"demand {name}"] = np.log(np.maximum(demands, math.exp(float(positive.min()) - 5.0)))
    if tie is not None:
        columns[f"score {tie[0]}"] = _scores(law_of(contents.resolved, tie[0]), contents.points[tie[0]])
    unit, factor = display_unit(entry.quantity)
    quantity, label = OUTPUTS.get(entry.quantity.partition(".")[0]), shorten(name, 30)
    if quantity is not None and quantity.fracture:
        label = PLACES.get(quantity.place, name)
    return {
        "name": name,
        "title": shorten(name, 40),
        "label": label,
        "quantity": entry.quantity,
        "aim": entry.aim,
        "target": entry.target,
        "unit": unit_text(unit),
        "file_unit": unit,
        "factor": factor,
        "law": _law(law, positive) if law is not None else {"kind": "fixed", "ln": math.log(_number(contents, name))},
        "mean": law.nominal_mean() if law is not None else _number(contents, name),
        "tie": None if tie is None else {"with": tie[0], "label": short_input(tie[0]), "spearman": tie[1]},
        "miss": [entry.miss.value, entry.miss.low, entry.miss.high],
        "word": entry.word if entry.target is not None else "",
        "reasons": [reason.text for reason in entry.reasons],
        "stays": [reason.text for reason in entry.reasons if reason.code in _STAYS],
        **_solved(results.margins.get(name)),
        **_judged(contents, _verdict_on(results, name), name, positive),
    }


def _solved(margin: MarginEntry | None) -> dict[str, object]:
    solved = None if margin is None or not margin.value else margin.value.value
    return {"solve": "" if margin is None or solved is None else margin.solve, "solved": solved}


def _verdict_on(results: Results, name: str) -> VerdictEntry | None:
    """The verdict that a limit is judged in."""
    entry = results.limits[name]
    judged = next((v for v in results.verdicts if (v.aim, v.target) == (entry.aim, entry.target)), None)
    return judged if judged is not None and any(one.name == name for one in judged.judged) else None


def _number(contents: Contents, name: str) -> float:
    """A strength that is a number."""
    strength = contents.resolved.limits[name].strength
    if isinstance(strength, str) or strength <= 0.0:
        raise _NotHere("the strength is not above zero")
    return float(strength)


def _demands(contents: Contents, name: str) -> Array:
    """The demand of a limit (n,) in every row of the sample.  Raises _NotHere."""
    samples, factor = (
        contents.samples.get(contents.results.limits[name].quantity),
        contents.resolved.limits[name].model_factor,
    )
    if samples is None:
        raise _NotHere("its demand is not stored")
    if samples.censored.mean() > _LATE:
        raise _NotHere("records end before the demand is known")
    own = contents.points[f"limits.{name}.model_factor"] if isinstance(factor, str) else float(factor)
    demands = np.asarray(samples.values * own)
    if not (demands > 0.0).any():
        raise _NotHere("the demand is zero in every row")
    return demands


def _tie(contents: Contents, name: str) -> tuple[str, float] | None:
    """The input that a strength depends on, and Spearman's correlation.  Raises _NotHere for another dependence."""
    own = strength_name(name)
    groups = [group for group in contents.resolved.dependence if own in group.of]
    if not groups:
        return None
    others = [one for one in groups[0].of if one != own]
    plain = len(groups) == 1 and len(others) == 1 and groups[0].copula == "gaussian" and groups[0].spearman is not None
    if not plain or others[0] not in contents.points:
        raise _NotHere("its strength depends on other inputs than by one Spearman correlation")
    if any(others[0] in group.of and len(contents.points.keys() & group.of) > 1
           for group in contents.resolved.dependence):  # fmt: skip
        raise _NotHere("what its strength depends on depends on further inputs")
    return others[0], float(groups[0].spearman or 0.0)


def _scores(law: Law | None, values: Array) -> Array:
    """Normal scores of the shares below some values, exact in both tails."""
    assert law is not None
    below, above = law.cdf(values), law.sf(values)
    with np.errstate(divide="ignore"):
        found = np.where(below <= 0.5, ndtri(below), -ndtri(above))
    return np.clip(found, -_NEVER, _NEVER)


def _check(contents: Contents, name: str, demands: Array, law: Law | None) -> None:
    """Raises _NotHere where the rows do not give the answer of the run: something in it is not what is known here."""
    entry, tie = contents.results.limits[name], _tie(contents, name)
    counts, kept = _kept(contents.replicates, len(demands))
    grid = kept[: min(counts) * len(counts)] if min(counts) == max(counts) else kept[: len(kept) // 2 * 2]
    shape = (len(counts) if min(counts) == max(counts) else 2, -1)
    shift, remaining = None, 1.0
    if tie is not None:
        correlation = correlation_from_spearman(("one", "other"), [(("one", "other"), tie[1])])
        pearson = 0.0 if correlation is None else float(correlation[0, 1])
        scores = _scores(law_of(contents.resolved, tie[0]), contents.points[tie[0]])
        shift, remaining = pearson * scores[grid].reshape(shape), math.sqrt(1.0 - pearson**2)
    strength = law if law is not None else _number(contents, name)
    state = LimitState(demands=demands[grid].reshape(shape), strength=strength, shift=shift, remaining_sd=remaining)
    found, known = miss(state, entry.aim), entry.miss
    ends = [logit(p, 1.0 - p) for p in (found.value, known.value, found.low, found.high) if p is not None]
    if len(ends) == 4 and np.isfinite(ends).all() and abs(ends[0] - ends[1]) > max(_OFF, ends[3] - ends[2]):
        raise _NotHere("its rows do not tell the answer of the run")


# --- laws -----------------------------------------------------------------------------------------------------


def _law(law: Law, logs: Array) -> dict[str, object]:
    """A law of strength as the page asks it; one that has no formula there as a table of scores over ln strength."""
    own = law.parameters
    if law.mass == 1.0 and law.family.name == "weibull":
        return {"kind": "weibull", "m": own["modulus"], "scale": own["scale"], "threshold": own.get("threshold", 0.0)}
    if law.mass == 1.0 and law.family.name == "lognormal":
        return {"kind": "lognormal", "mu": own["log_mean"], "sd": own["log_sd"]}
    places = np.linspace(logs.min() - _BEYOND, logs.max() + _BEYOND, _PLACES)
    scores = _scores(law, np.exp(places)).round(4).tolist()
    return {"kind": "table", "from": places[0], "step": places[1] - places[0], "scores": scores}


# --- verdicts -------------------------------------------------------------------------------------------------


def _judged(contents: Contents, judged: VerdictEntry | None, name: str, logs: Array) -> dict[str, object]:
    """What a limit is judged together with: other limits of the file, and ways with assumed strengths."""
    if judged is None:
        return {"together": [], "ways": [], "base": None}
    sliders, ways, missing = contents.sliders or Sliders(), [], []
    for one in judged.judged:
        way = sliders.ways.get(one.name)
        if not one.assumed:
            continue
        if way is None:
            missing.append(one.name)
            continue
        laws = [_law(stored_law(table, one.name), logs) for table in way.laws]
        ways.append({"name": one.name, "quantity": way.quantity, "laws": laws, "miss": one.miss.value,
                     "scales": way.scales})  # fmt: skip
    others = [one.name for one in judged.judged if not one.assumed and one.name != name]
    base = judged.miss
    return {"together": others, "ways": ways, "unmoved": missing, "base": [base.value, base.low, base.high]}


# --- sliders --------------------------------------------------------------------------------------------------


def _slider(contents: Contents, one: SliderEntry, service: str) -> dict[str, object]:
    """A slider, with the key that the study file has it by: the rig of a service stands in its own tables."""
    table, _, rest = one.name.partition(".")
    key = one.name
    if service and table not in ("sphere", "contact"):
        key = f"service.{service}.{rest if table == 'rig' else one.name}"
    unit, factor = display_unit(one.name)
    law = contents.resolved.random.get(one.name)
    # what a law is cut off at keeps its place relative to the mean (`Law.with_mean`), and a study has to be told so
    own = law_of(contents.resolved, one.name)
    cut = {} if law is None or own is None or own.family.bounded else {"lower": law.lower, "upper": law.upper}
    return {
        "path": one.name,
        "cut": {key: bound / one.base for key, bound in cut.items() if bound is not None},
        "key": key,
        "set": key if law is None else f"{key}.mean",
        "label": _CALLED.get(one.name) or short_input(one.name),
        "unit": unit_text(unit),
        "file_unit": unit,
        "factor": factor,
        **one.model_dump(include={"low", "high", "base", "nodes", "centres", "spreads"}),
    }


def _surface(one: SurfaceEntry) -> dict[str, object]:
    """What is small against the error of a surface is left out, in all no more than a twentieth of it."""
    order = np.argsort(np.abs(one.coefficients))
    left = order[np.cumsum(np.abs(np.array(one.coefficients)[order])) > 0.05 * one.error].tolist()
    return {
        "p": ["".join(map(str, one.powers[k])) for k in left],
        "c": [float(f"{one.coefficients[k]:.6g}") for k in left],
        "error": one.error,
    }
