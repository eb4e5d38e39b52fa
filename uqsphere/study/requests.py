"""What a study asks: model, limits and analysis."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from uqsphere.mechanics.criteria import PATHS
from uqsphere.quantities import OUTPUTS, Quantity, lookup
from uqsphere.study.criterion import KEYS, CriterionReading, read_criterion, with_modulus_of
from uqsphere.study.document import AnalysisTable, LimitTable, ModelTable
from uqsphere.study.faults import Findings, Place, one_of, shown, suggestion
from uqsphere.study.numbers import Reading, read_fixed, read_number
from uqsphere.study.scene import Scene
from uqsphere.study.sensitivities import read_tolerance
from uqsphere.study.sphere_tests import is_sphere_tests, read_sphere_tests
from uqsphere.study.study import Accuracy, Analysis, Budget, Limit, ModelChoice

__all__ = ["LimitReading", "read_analysis", "read_limits", "read_model", "shares", "valid_name"]

METHODS: Final = ("qmc", "pce", "sobol", "form", "importance", "subset")
LATER_METHODS: Final = ("sorm", "monte_carlo", "active")
MOST_LIMITS: Final = 50
#: rows of one stored chunk, `uqsphere.runner.chunks`
MOST_ROWS: Final = 16_384

_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,63}")
_TIME: Final = Quantity(name="time", symbol="t", dimension="time", meaning="the time")


@dataclass(frozen=True, kw_only=True)
class LimitReading:
    """A limit with its parts as understood; None where a part is faulty."""

    name: str
    quantity: str | None
    strength: Reading | None
    model_factor: Reading | None
    table: LimitTable
    criterion: CriterionReading | None = None

    @property
    def parts(self) -> dict[str, Reading | None]:
        """The numbers that can be random, by the names they go by."""
        return {
            f"limits.{self.name}.strength": self.strength,
            f"limits.{self.name}.model_factor": self.model_factor,
        }

    def limit(self) -> Limit | None:
        """The noun, if every part is there."""
        if self.quantity is None or self.strength is None or self.model_factor is None:
            return None
        found = self.criterion
        return Limit(
            name=self.name,
            criterion=None if found is None else found.criterion,
            parameters={} if found is None else found.parameters,
            quantity=self.quantity,
            strength=self.strength.value,
            aim=self.table.aim,
            model_factor=self.model_factor.value,
            target=self.table.target,
            fracture=self.table.fracture,
        )


def valid_name(name: str) -> bool:
    """Whether a name of the user's can stand in tables, figures and file names."""
    return _NAME.fullmatch(name) is not None


def read_model(table: ModelTable, findings: Findings) -> ModelChoice:
    """The choice of mechanics."""
    if not 1e-12 <= table.tolerance <= 1e-2:
        findings.add(("model", "tolerance"), f"found {table.tolerance!r}, from 1e-12 to 1e-2 is allowed")
    horizon = None
    if table.horizon is not None:
        horizon = read_fixed(table.horizon, ("model", "horizon"), _TIME, findings)
    return ModelChoice(
        fidelity=table.fidelity,
        tolerance=table.tolerance,
        first_loading_only=table.first_loading_only,
        horizon=horizon,
        compare_with_paper=table.compare_with_paper,
    )


def read_limits(
    tables: Mapping[str, LimitTable], outputs: Sequence[str] | None, findings: Findings, folder: Path, scene: Scene
) -> list[LimitReading]:
    """The limits; `outputs` are the names of a black box (None: those of the impact model)."""
    found: list[LimitReading] = []
    if len(tables) > MOST_LIMITS:
        findings.add(("limits",), f"found {len(tables)} limits, at most {MOST_LIMITS} are allowed")
        return found
    for name, table in tables.items():
        place: Place = ("limits", name)
        if not valid_name(name):
            findings.add(place, _NAME_RULE)
            continue
        criterion = None
        if table.criterion is None:
            quantity = _limit_quantity(table, place, outputs, findings)
        else:
            criterion = read_criterion(table, name, outputs is not None, findings)
            quantity = None if criterion is None else criterion.quantity
        strength = model_factor = None
        if table.strength is None:
            if findings.clean((*place, "strength")):
                findings.add(
                    (*place, "strength"),
                    'strength is missing: add a number such as "4 GPa", or a distribution',
                )
        elif quantity is not None and outputs is None and is_sphere_tests(table.strength):
            place_of = (*place, "strength")
            strength = read_sphere_tests(table.strength, place_of, quantity, criterion, scene, findings, folder)
        elif quantity is not None:
            strength = read_number(table.strength, (*place, "strength"), _strength_of(quantity), findings, folder)
        else:
            # Without its quantity the strength has no unit to be read in: neither right nor wrong.
            findings.spoiled.add((*place, "strength"))
        if criterion is not None:
            criterion = with_modulus_of(strength, criterion, name, findings)
            quantity = None if criterion is None else quantity
        if table.model_factor is not None:
            model_factor = read_number(table.model_factor, (*place, "model_factor"), _FACTOR, findings, folder)
        elif findings.clean((*place, "model_factor")):
            model_factor = Reading(value=1.0)
        if table.target is not None and not 0.0 < table.target < 1.0:
            findings.add((*place, "target"), f"found {table.target!r}, a probability between 0 and 1 is due")
        check_fracture(table, quantity, place, findings)
        found.append(
            LimitReading(
                name=name,
                quantity=quantity,
                strength=strength,
                model_factor=model_factor,
                table=table,
                criterion=criterion,
            )
        )
    return found


def check_fracture(table: LimitTable, quantity: str | None, place: Place, findings: Findings) -> None:
    """Refuse a limit that is said to mean fracture and is held against something that cannot."""
    if not table.fracture or quantity is None or table.criterion is not None or quantity in PATHS:
        return
    findings.add(
        (*place, "fracture"),
        f"exceeding {quantity} breaks no sphere: fracture = true is for a criterion or one of {one_of(sorted(PATHS))}",
    )


_NAME_RULE: Final = "a name takes up to 64 letters, digits, _ and -, and begins with a letter"
_FACTOR: Final = Quantity(
    name="model_factor", symbol="f", dimension="number", meaning="the model factor", plausible=(0.5, 2.0)
)
#: pressures [Pa] that a strength is likely to be
_STRONG: Final = (1e4, 1e12)


def _strength_of(quantity: str) -> Quantity:
    entry = lookup(quantity)
    return Quantity(
        name=entry.name,
        symbol=entry.symbol,
        dimension=entry.dimension,
        display=entry.display,
        lower=entry.lower,
        upper=entry.upper,
        meaning=f"the strength against {quantity}",
        plausible=_STRONG if entry.dimension == "pressure" else (0.0, math.inf),
    )


def _limit_quantity(table: LimitTable, place: Place, outputs: Sequence[str] | None, findings: Findings) -> str | None:
    for key in KEYS:
        if getattr(table, key) is not None:
            findings.add((*place, key), f"{key} belongs to a criterion: add criterion = … (uqsphere list criteria)")
    if table.quantity is None:
        if findings.clean((*place, "quantity")):
            findings.add((*place, "quantity"), f'quantity is missing: add quantity = "{(outputs or ["p_max"])[0]}"')
        return None
    return table.quantity if _known_quantity(table.quantity, (*place, "quantity"), outputs, findings) else None


def _known_quantity(name: str, place: Place, outputs: Sequence[str] | None, findings: Findings) -> bool:
    known = list(OUTPUTS) if outputs is None else list(outputs)
    if name in known:
        return True
    if known:
        findings.add(place, f"unknown quantity {shown(name)}, known: {one_of(known[:40])}{suggestion(name, known)}")
    return False


def read_analysis(
    table: AnalysisTable, outputs: Sequence[str] | None, limits: Sequence[LimitReading], findings: Findings
) -> Analysis:
    """What is asked of every quantity; those that a limit needs are among them."""
    asked = _quantities(table.quantities, outputs, limits, findings)
    for key, value in table.accuracy:
        if not value > 0.0:
            findings.add(("analysis", "accuracy", key), f"found {value!r}, a number above 0 is due")
    if table.budget.evaluations <= 0:
        found = table.budget.evaluations
        findings.add(("analysis", "budget", "evaluations"), f"found {found}, a whole number above 0 is due")
    time = read_fixed(table.budget.time, ("analysis", "budget", "time"), _TIME, findings)
    rows_per_call, time_limit = _calls(table, outputs is not None, findings)
    return Analysis(
        quantities=asked,
        accuracy=Accuracy(**table.accuracy.model_dump()),
        budget=Budget(evaluations=table.budget.evaluations, time=time or Budget().time, exhaust=table.budget.exhaust),
        quantiles=shares(table.quantiles, ("analysis", "quantiles"), findings),
        methods=_methods(table.methods, findings),
        cost=_cost(table.cost, outputs is not None, findings),
        on_failure=table.on_failure,
        second_order=table.second_order,
        tolerance_intervals=read_tolerance(table.tolerance_intervals, findings),
        rows_per_call=rows_per_call,
        time_limit=time_limit,
    )


def _cost(given: Any, black_box: bool, findings: Findings) -> float | None:
    """Seconds that one evaluation of a black box takes, if the file says so."""
    place: Place = ("analysis", "cost")
    if given is None:
        return None
    if not black_box:
        findings.add(place, "the cost of the impact model is known: cost is for black boxes, leave it out")
        return None
    seconds = read_fixed(given, place, _TIME, findings)
    if seconds is not None and not seconds > 0.0:
        findings.add(place, f'found {shown(given)}, a time above 0 such as "10 s" is due')
        return None
    return seconds


def _calls(table: AnalysisTable, black_box: bool, findings: Findings) -> tuple[int | None, float | None]:
    """How a black box is called: rows in a call, and seconds an evaluation may take."""
    for key in ("rows_per_call", "time_limit"):
        if getattr(table, key) is not None and not black_box:
            findings.add(("analysis", key), f"{key} is for a black box ([inputs], [outputs])")
            return None, None
    rows = table.rows_per_call
    if rows is not None and not 1 <= rows <= MOST_ROWS:
        findings.add(("analysis", "rows_per_call"), f"found {rows}, from 1 to {MOST_ROWS:,} rows are allowed")
    if table.time_limit is None:
        return rows, None
    limit = read_fixed(table.time_limit, ("analysis", "time_limit"), _TIME, findings)
    if limit is not None and not limit > 0.0:
        findings.add(("analysis", "time_limit"), f"found {table.time_limit!r}, a time above 0 is due")
    # a limit is kept by ending a process: one row in each call unless the study says otherwise
    return rows or 1, limit


def _quantities(
    given: Sequence[str] | None,
    outputs: Sequence[str] | None,
    limits: Sequence[LimitReading],
    findings: Findings,
) -> tuple[str, ...]:
    needed = [limit.quantity for limit in limits if limit.quantity is not None]
    if given is None:
        default = list(outputs) if outputs is not None else (needed or ["p_max", "contact_time"])
        return tuple(dict.fromkeys([*default, *needed]))
    place: Place = ("analysis", "quantities")
    if not given:
        findings.add(place, "the list is empty: name a quantity, or leave the key out")
    for index, name in enumerate(given):
        if name in given[:index]:
            findings.add((*place, index), f"{shown(name)} is named twice")
        else:
            _known_quantity(name, (*place, index), outputs, findings)
    return tuple(dict.fromkeys([*given, *needed]))


def shares(values: Sequence[float], place: Place, findings: Findings) -> tuple[float, ...]:
    """Probabilities inside (0, 1), in order, each once."""
    if not 1 <= len(values) <= 200:
        findings.add(place, f"found {len(values)} numbers, from 1 to 200 are due")
        return ()
    for index, value in enumerate(values):
        if not 0.0 < value < 1.0:
            findings.add((*place, index), f"found {value!r}, a number between 0 and 1, both excluded, is due")
    return tuple(sorted(set(values)))


def _methods(given: Any, findings: Findings) -> tuple[str, ...]:
    place: Place = ("analysis", "methods")
    if given == "auto" or given == ["auto"]:
        return ("auto",)
    if not isinstance(given, list) or not given:
        hint = f'; write methods = ["{given}"]' if given in METHODS else ""
        findings.add(place, f'found {shown(given)}: "auto" or a list of {one_of(METHODS)} is due{hint}')
        return ("auto",)
    for index, name in enumerate(given):
        if isinstance(name, str) and name in LATER_METHODS:
            findings.add(
                (*place, index),
                f"the method {shown(name)} is not in this version; allowed: {one_of(METHODS)}",
            )
        elif not isinstance(name, str) or name not in METHODS:
            near = suggestion(name, METHODS) if isinstance(name, str) else ""
            findings.add((*place, index), f"unknown method {shown(name)}, allowed: {one_of(METHODS)}{near}")
        elif name in given[:index]:
            findings.add((*place, index), f"{shown(name)} is named twice")
    return tuple(name for name in given if isinstance(name, str))
