"""Scenes spread over everything that can be asked of the model, balanced and reproducible.

Every stratum is one structure (shape of the pulse, infinite or finite bars, ...); inside it a Latin
hypercube spreads mu, theta and the inputs over their ranges, logarithmically where they span
decades.  What is left over is solved for: the bar's diameter, or the sphere's density where the bar
would be thinner than the sphere, gives mu; the pulse's duration gives theta; the bars' lengths
follow from the pulse.
"""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from tests.campaigns import options, table
from tests.energies import balance_of, rates_of
from uqsphere.mechanics.integrator import solve as integrator
from uqsphere.mechanics.integrator.solve import motions, solve
from uqsphere.mechanics.outputs import SceneAnswers, absent_in
from uqsphere.mechanics.scene import STATUS, Scene, answered
from uqsphere.quantities import OUTPUTS

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]
#: name -> low end, high end, evenly over the logarithm
Ranges = Mapping[str, tuple[float, float, bool]]

#: what a Latin hypercube spreads: range, and whether evenly over the logarithm
RANGES: Final[Ranges] = {
    "mu": (1e-7, 1e3, True),
    "theta": (1e-4, 1e4, True),
    "sphere.E": (1e6, 1e12, True),
    "sphere.nu": (0.0, 0.4999, False),
    "sphere.radius": (1e-5, 1.0, True),
    "sphere.density": (500.0, 2e4, True),
    "striker.speed": (1e-6, 100.0, True),
    "bars.E": (1e9, 1e12, True),
    "bars.nu": (0.0, 0.4999, False),
    "bars.density": (500.0, 2e4, True),
    "bars.end_radius": (1e-2, 1e3, True),  # over the sphere's radius
    "incident": (1.0, 1e3, True),  # round trip of the incident bar over the whole pulse
    "ratio": (1e-2, 1e2, True),  # receiving bar over incident bar
    "rise": (1e-4, 1.0, True),  # over the pulse's width
    "fall": (1e-4, 1.0, True),
    "first": (0.05, 0.45, False),  # places of the two peaks over the pulse's duration
    "second": (0.5, 0.95, False),
    "level1": (0.1, 2.0, True),
    "level2": (0.1, 2.0, True),
    "valley": (0.0, 1.0, False),
    "end1": (-1.0, 1.0, False),
    "end3": (-1.0, 1.0, False),
}
#: ranges without the lightest spheres under the longest pulses, whose motions swing most often
SHORT: Final[Ranges] = {
    "mu": (1e-4, 1e3, True),
    "theta": (0.1, 30.0, True),
    "ratio": (0.1, 10.0, True),
    "incident": (1.0, 30.0, True),
}
#: ends of the bars that have names; every second row has one of these, the others any number
#: between
_NAMED_ENDS: Final = np.array([1.0, 0.0, -1.0])


@dataclass(frozen=True, kw_only=True)
class Stratum:
    """One structure of scenes.  `rounded`: bar ends with a radius; `by_striker`: the striker's
    length gives theta.
    """

    shape: str = "rectangular"
    infinite: bool = False
    first_loading_only: bool = False
    rigid_contact: bool = False
    rounded: bool = False
    by_striker: bool = False


STRATA: Final[tuple[Stratum, ...]] = (
    Stratum(infinite=True, by_striker=True),
    Stratum(by_striker=True),
    Stratum(first_loading_only=True),
    Stratum(shape="trapezoid", infinite=True, rounded=True),
    Stratum(shape="trapezoid"),
    Stratum(shape="half_sine", infinite=True, rigid_contact=True),
    Stratum(shape="half_sine"),
    Stratum(shape="two_peak", infinite=True),
    Stratum(shape="two_peak", rounded=True),
    Stratum(shape="step", infinite=True),
    Stratum(shape="step"),
)


def _hypercube(count: int, rng: np.random.Generator, narrower: Ranges) -> dict[str, Array]:
    """Latin hypercube over RANGES, a column each."""
    columns = {}
    for name, (low, high, log) in {**RANGES, **narrower}.items():
        share = (rng.permutation(count) + rng.random(count)) / count
        columns[name] = low * (high / low) ** share if log else low + (high - low) * share
    return columns


def _ends(drawn: Array, rng: np.random.Generator) -> Array:
    named = _NAMED_ENDS[rng.integers(0, len(_NAMED_ENDS), len(drawn))]
    return np.where(rng.random(len(drawn)) < 0.5, named, drawn)


def _pulse(
    stratum: Stratum, drawn: Mapping[str, Array], width: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """Columns of the pulse whose width is `width` [s]."""
    if stratum.shape == "trapezoid":
        flat = rng.random((2, len(width))) < 0.1  # a tenth of them jump
        return {
            "pulse.rise": np.where(flat[0], 0.0, drawn["rise"] * width),
            "pulse.fall": np.where(flat[1], 0.0, drawn["fall"] * width),
        }
    if stratum.shape == "two_peak":
        return {
            "pulse.t1": drawn["first"] * width,
            "pulse.t2": drawn["second"] * width,
            "pulse.level1": drawn["level1"],
            "pulse.level2": drawn["level2"],
            "pulse.valley": drawn["valley"] * np.minimum(drawn["level1"], drawn["level2"]),
        }
    return {}


def _columns(
    stratum: Stratum, count: int, rng: np.random.Generator, narrower: Ranges
) -> dict[str, Array]:
    """Inputs of `count` scenes of one structure."""
    drawn = _hypercube(count, rng, narrower)
    columns = {
        name: drawn[name] for name in drawn if name.startswith(("sphere.", "bars.", "striker."))
    }
    end_radius = columns.pop("bars.end_radius") * columns["sphere.radius"]
    if stratum.rounded:
        columns["bars.end_radius"] = end_radius
    # mu goes with diameter^(-10/3) and with the density; measured on a bar twice as wide as the
    # sphere
    columns["bars.diameter"] = 4.0 * columns["sphere.radius"]
    trial = Scene(
        columns={**columns, "pulse.duration": np.ones(count)},
        infinite=True,
        rigid_contact=stratum.rigid_contact,
    ).scales.mass_number
    wider = (trial / drawn["mu"]) ** 0.3
    columns["bars.diameter"] = columns["bars.diameter"] * np.maximum(wider, 0.51)
    columns["sphere.density"] = columns["sphere.density"] * np.minimum(1.0, wider / 0.51) ** (
        -10.0 / 3.0
    )
    time = Scene(
        columns={**columns, "pulse.duration": np.ones(count)},
        infinite=True,
        rigid_contact=stratum.rigid_contact,
    ).scales.time
    width = drawn["theta"] * time
    speed = np.sqrt(columns["bars.E"] / columns["bars.density"])
    if stratum.by_striker:
        columns["striker.length"] = 0.5 * speed * width
    else:
        columns["pulse.duration"] = width
    pulse = _pulse(stratum, drawn, width, rng)
    columns.update(pulse)
    if not stratum.infinite:
        whole = (
            width + 0.5 * (pulse["pulse.rise"] + pulse["pulse.fall"])
            if stratum.shape == "trapezoid"
            else width
        )
        columns["bars.incident_length"] = 0.5 * speed * whole * drawn["incident"]
        columns["bars.receiving_length"] = columns["bars.incident_length"] * drawn["ratio"]
        columns["bars.incident_end"] = _ends(drawn["end1"], rng)
        columns["bars.receiving_end"] = _ends(drawn["end3"], rng)
        if (
            stratum.shape == "step"
        ):  # it is longer than any round trip: nothing may come back behind it
            columns["bars.incident_end"] = np.zeros(count)
    return columns


def _scenes(
    stratum: Stratum, count: int, rng: np.random.Generator, narrower: Ranges
) -> list[Scene]:
    """Scenes of one structure; a step on infinite bars needs a horizon, which a batch shares."""
    columns = _columns(stratum, count, rng, narrower)
    structure: dict[str, Any] = {
        "shape": stratum.shape,
        "infinite": stratum.infinite,
        "first_loading_only": stratum.first_loading_only,
        "rigid_contact": stratum.rigid_contact,
    }
    if not (stratum.shape == "step" and stratum.infinite):
        return [Scene(columns=columns, **structure)]
    wanted = columns.pop("pulse.duration")
    parts = np.array_split(np.argsort(wanted), max(1, min(32, count // 4)))
    return [
        Scene(
            columns={name: column[part] for name, column in columns.items()},
            **structure,
            horizon=float(np.exp(np.log(wanted[part]).mean())),
        )
        for part in parts
        if len(part)
    ]


def design(
    count: int,
    seed: int,
    *,
    strata: tuple[Stratum, ...] = STRATA,
    narrower: Ranges = MappingProxyType({}),
) -> list[Scene]:
    """`count` rows, as evenly over the strata as can be; the same for the same count and seed.

    narrower: entries of RANGES to put in their place, to keep a sweep short: light spheres under
    long pulses cost most.
    """
    scenes: list[Scene] = []
    for index, share in enumerate(np.array_split(np.arange(count), len(strata))):
        if len(share):
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
            scenes += _scenes(strata[index], len(share), rng, narrower)
    return scenes


def as_inputs(scene: Scene, row: int) -> dict[str, Any]:
    """One row as a dict that builds it again: `Scene(**{**found, "columns": {name:
    np.array([value]) ...}})`.
    """
    return {
        "columns": {name: float(column[row]) for name, column in scene.columns.items()},
        "shape": scene.shape,
        "infinite": scene.infinite,
        "rigid_contact": scene.rigid_contact,
        "first_loading_only": scene.first_loading_only,
        "horizon": scene.horizon,
        "contact_law": scene.contact_law,
    }


# --- The kernel over the whole range of inputs: against the second integrator, or itself at a
# closer tolerance. A row is wrong if it has an answer and a quantity is off by more than five times
# the tolerance.  It is silent unless the kernel marks that its contact grazes zero, and nothing but
# what follows from the first loss is wrong.

#: an error may be this many times the tolerance that was asked for
ALLOWED: Final = 5.0
#: quantities that follow from others row by row: their errors are those of the pressure, or of the
#: energy; the mean of both forces is held in `tests.mechanics.test_rigs_kernel`
_DERIVED: Final = frozenset(name for name, entry in OUTPUTS.items() if entry.place) - {
    "p_max",
    "first_peak",
} | {
    "energy_sphere",
    "specific_energy_sphere",
    "mean_force_max",
}
#: what a loss of contact that is a swing sooner or later changes
_TIMES: Final = frozenset({"time_to_first_loss", "contact_duration"})
#: sums that an error is measured by, where it is not the quantity itself: the approach, and the
#: work done on the faces
_UNITS: Final = MappingProxyType(
    {"dent": ("alpha_max",), "plastic_work": ("plastic_work", "energy")}
)


@dataclass(frozen=True, kw_only=True)
class Wrong:
    """A row that is wrong: inputs, similarity numbers, (found, expected, error over tolerance) by
    quantity; whether the kernel has marked it."""

    inputs: dict[str, Any]
    mu: float
    theta: float
    quantities: dict[str, tuple[float, float, float]]
    marked: bool


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Errors of n rows over the tolerance, (n, quantities), NaN where there is nothing to compare.

    `status` (n,) are those of the kernel, `marked` (n,) whether contact grazes zero; `judged` (n,)
    says where the other side has an answer; `mu`, `theta` (n,).
    """

    names: tuple[str, ...]
    errors: Array
    status: npt.NDArray[np.int64]
    marked: npt.NDArray[np.bool_]
    judged: npt.NDArray[np.bool_]
    mu: Array
    theta: Array
    wrong: tuple[Wrong, ...]

    @property
    def silent(self) -> tuple[Wrong, ...]:
        """Rows that are wrong, and nothing says so."""
        return tuple(
            row for row in self.wrong if not (row.marked and set(row.quantities) <= _TIMES)
        )


#: values and which times were cut off by the record's end, by name (n,), and in which rows there
#: are any
_Answer = tuple[Mapping[str, Any], Mapping[str, Any], npt.NDArray[np.bool_]]


def _error(name: str, found: SceneAnswers, truth: _Answer, tolerance: float) -> Array:
    """Error of one quantity over the tolerance (n,).

    It is relative, but for the force imbalance, a difference of two forces over the largest:
    absolute, and for what is left of larger numbers that it is the difference of: dent and plastic
    work, nothing at the onset (`_UNITS`).  A time that one side says was cut off by the record's
    end and the other says was not differs without bound, unless both times agree.
    """
    value, expected = np.asarray(found.values[name]), np.asarray(truth[0][name])
    unit = np.abs(sum(np.asarray(truth[0][part]) for part in _UNITS.get(name, (name,))))
    with np.errstate(all="ignore"):
        error = np.abs(value - expected) / (1.0 if name == "force_imbalance" else unit) / tolerance
    error = np.where(value == expected, 0.0, error)
    if found.censored is not None and name in truth[1]:
        error = np.where(
            (found.censored[name] != truth[1][name]) & (error > ALLOWED), np.inf, error
        )
    return np.asarray(error)


def _compare(
    plan: Sequence[Scene],
    tolerance: float,
    judge: Callable[[Scene, SceneAnswers], _Answer],
    answers: Callable[..., SceneAnswers] = solve,
) -> Comparison:
    """The kernel at `tolerance` against a judge, on every row."""
    parts: list[Comparison] = []
    for scene in plan:
        found = answers(scene, tolerance=tolerance)
        truth = judge(scene, found)
        names = tuple(
            name
            for name in OUTPUTS
            if name in found.values and name in truth[0] and name not in _DERIVED
        )
        compared = truth[2] & answered(found.status)
        errors = np.stack([_error(name, found, truth, tolerance) for name in names], axis=-1)
        errors[~compared] = np.nan
        mu, theta = scene.scales.mass_number, scene.scales.pulse_number
        wrong = tuple(
            Wrong(
                inputs=as_inputs(scene, row),
                mu=float(mu[row]),
                theta=float(theta[row]),
                quantities={
                    name: (float(found.values[name][row]), float(truth[0][name][row]), float(error))
                    for name, error in zip(names, errors[row], strict=True)
                    if not error <= ALLOWED
                },
                marked=bool(found.grazes[row]),
            )
            for row in np.flatnonzero(compared & ~(errors <= ALLOWED).all(axis=1))
        )
        parts.append(
            Comparison(
                names=names,
                errors=errors,
                status=found.status,
                marked=found.grazes > 0.0,
                judged=truth[2],
                mu=mu,
                theta=theta,
                wrong=wrong,
            )
        )
    return merged(parts)


def merged(parts: Sequence[Comparison]) -> Comparison:
    """The comparison of several plans as one."""
    columns = ("errors", "status", "marked", "judged", "mu", "theta")
    return replace(
        parts[-1],
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in columns},
        wrong=tuple(row for part in parts for row in part.wrong),
    )


def against_itself(
    plan: Sequence[Scene],
    *,
    tolerance: float = 1e-6,
    closer: float = 1e-8,
    quantities: Collection[str] | None = None,
    alone: bool = False,
) -> Comparison:
    """The kernel at `tolerance`, `alone` asked for one quantity at a time, against the kernel at
    `closer`, asked for all at once.
    """

    def judge(scene: Scene, found: SceneAnswers) -> _Answer:
        truth = solve(scene, tolerance=closer, quantities=quantities)
        return truth.values, truth.censored or {}, answered(truth.status) & answered(found.status)

    answers = one_at_a_time if alone else partial(solve, quantities=quantities)
    return _compare(plan, tolerance, judge, answers)


def one_at_a_time(scene: Scene, *, tolerance: float) -> SceneAnswers:
    """Answers of a scene, of one call for each quantity; a row fails if any call does."""
    names = [name for name in OUTPUTS if name not in _DERIVED and not absent_in(scene, name)]
    parts = [solve(scene, tolerance=tolerance, quantities=(name,)) for name in names]
    return replace(
        parts[0],
        values={name: part.values[name] for name, part in zip(names, parts, strict=True)},
        censored={name: flags for part in parts for name, flags in part.censored.items()},
        grazes=np.logical_or.reduce([part.grazes for part in parts]),
        status=np.maximum.reduce([part.status for part in parts]),
    )


def against_reference(
    plan: Sequence[Scene], *, tolerance: float = 1e-6, budget: int = 4000, rtol: float = 1e-12
) -> Comparison:
    """The kernel against the second integrator; a row that takes that more than `budget` steps is
    not judged.
    """
    from tests.independent.motion import Reference, Unaffordable, refer

    def judge(scene: Scene, found: SceneAnswers) -> _Answer:
        known: dict[int, Reference] = {}
        goes_on = found.record > found.values["time_to_first_loss"] * (1.0 + 1e-9)
        until = np.where(goes_on, found.record, np.inf)
        for row in np.flatnonzero(scene.status == 0).tolist():
            with contextlib.suppress(Unaffordable):
                known[row] = refer(scene, row, until=until[row], budget=budget, rtol=rtol)
        none = np.full(len(scene), np.nan)
        # the equivalent duration has a campaign of its own (`durations`)
        values = {name: none.copy() for name in found.values if name != "contact_duration"}
        flags = {"time_to_first_loss": np.zeros(len(scene), dtype=bool)}
        for row, one in known.items():
            for into, answers in ((values, one.values), (flags, one.censored)):
                for name in into.keys() & answers.keys():
                    into[name][row] = answers[name]
        return values, flags, np.isin(np.arange(len(scene)), list(known))

    return _compare(plan, tolerance, judge)


def report(found: Comparison) -> str:
    """The comparison as text: errors over the tolerance by quantity, rows by status, wrong and
    silent rows.
    """
    compared = found.judged & answered(found.status)
    rows = []
    for name, column in zip(found.names, found.errors[compared].T, strict=True):
        if len(column):
            middle, high = np.quantile(column, [0.5, 0.999], method="higher")
            rows.append(
                [
                    f"`{name}`",
                    f"{middle:.1e}",
                    f"{high:.2g}",
                    f"{column.max():.2g}",
                    int((~(column <= ALLOWED)).sum()),
                ]
            )
    states = [
        [
            code,
            int((found.status == code).sum()),
            int(((found.status == code) & ~found.judged).sum()),
            STATUS[int(code)],
        ]
        for code in np.unique(found.status)
    ]
    lines = [
        f"{len(found.status)} scenes, {int(compared.sum())} compared",
        "",
        table(["error over tolerance", "median", "99.9 %", "worst", "rows above 5"], rows),
        "",
        table(["status", "rows", "not judged", "meaning"], states),
        "",
        f"wrong and silent: {len(found.silent)} rows; contact grazes zero in "
        f"{int(found.marked[compared].sum())}, "
        f"of which {len(found.wrong) - len(found.silent)} differ",
    ]
    for wrong in found.silent:
        listed = ", ".join(
            f"{name} {error:.2g}" for name, (_, _, error) in wrong.quantities.items()
        )
        lines += [f"- mu {wrong.mu:.3g}, theta {wrong.theta:.3g}: {listed}", f"  {wrong.inputs}"]
    return "\n".join(lines)


# --- faces with laws of their own -----------------------------------------------------------------


def with_law(plan: Sequence[Scene], seed: int) -> list[Scene]:
    """The same scenes with faces that yield: first yield at 1e-4 to 1.2 of the approach at P_0,
    H/p_y = 1 to 4, C = 1 to 2.9 (one in six is Thornton's)."""
    rng, made = np.random.default_rng(seed), []
    for scene in plan:
        count, scales = len(scene), scene.scales
        pile_up = rng.choice([1.0, 1.5, 2.0, 8.0 / 3.0, 2.9], count)
        ratio = rng.uniform(1.25, 4.0, count)
        ratio = np.where((pile_up == 1.0) & (rng.random(count) < 0.8), 1.0, ratio)
        hertz = 2.0 / np.pi * scales.modulus * np.sqrt(scales.approach / scales.effective_radius)
        onset = hertz * 10.0 ** rng.uniform(-2.0, 0.04, count)
        columns = {
            "contact.onset_pressure": onset,
            "contact.hardness": onset * ratio,
            "contact.pile_up": pile_up,
        }
        made.append(replace(scene, columns={**scene.columns, **columns}, contact_law="plastic"))
    return made


def unbalanced(scene: Scene, row: int, tolerance: float) -> float:
    """Work of the bars less what is in the sphere and its faces at the end of a motion, over the
    most that was in them.

    The sums run over the series of the motion, at Gauss points; what is lost to yield follows from
    the largest forces by the laws themselves. (C15).
    """
    found = motions(scene, np.array([row]), tolerance=tolerance)[0]
    if isinstance(found, int):
        return math.nan
    # the first step, from a touch, is a cubic between ends that are closer: what it holds counts
    # from its end
    starts, lengths = (
        found.start[1:] * found.unit,
        np.minimum(found.length, found.end - found.start)[1:] * found.unit,
    )
    if len(starts) == 0:
        return math.nan
    nodes, weights = np.polynomial.legendre.leggauss(24)
    times = starts[:, None] + lengths[:, None] * 0.5 * (1.0 + nodes)
    states, rates = found.states_at(times.ravel()), rates_of(found, times.ravel())
    forces = found.forces_at(times.ravel())
    power = forces[:, 0] * (states[:, 2] + rates[:, 0]) - forces[:, 1] * (
        states[:, 2] - rates[:, 1]
    )
    work = np.cumsum((0.5 * lengths) * (power.reshape(times.shape) @ weights))
    passed = float((0.5 * lengths) @ (np.abs(power).reshape(times.shape) @ weights))
    balance = balance_of(found, np.concatenate([starts, starts[-1:] + lengths[-1:]]))
    held = balance.kinetic + balance.stored.sum(axis=0) + balance.plastic.sum(axis=0)
    return float(abs(work[-1] - held[-1] + held[0]) / max(passed, held.max()))


def balances(plan: Sequence[Scene], tolerance: float) -> Array:
    """`unbalanced` of every row inside the domain, over the tolerance."""
    found = [
        unbalanced(scene, int(row), tolerance)
        for scene in plan
        for row in np.flatnonzero(scene.status == 0)
    ]
    return np.array(found) / tolerance


#: scenes of a slice: one seed each, so that a sweep that is ended early has said what it found
SLICE: Final = 110


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the table after every slice.  `--room`: steps that a reflection still needs, at
    most.
    """
    asked = options(
        "N hard scenes against a tighter tolerance, or the second integrator (--alone: asked for "
        "one quantity at a time)",
        arguments,
        words=(),
        reference=False,
        alone=False,
        seed=1,
        law="hertz",
        short=False,
        balances=False,
        room=262_144,
    )
    scenes = int(asked.words[0])
    integrator._CAPACITIES = tuple(room for room in integrator._CAPACITIES if room <= asked.room)
    off: list[Array] = []
    parts: list[Comparison] = []
    for k, begin in enumerate(range(0, scenes, SLICE)):
        plan = design(
            min(SLICE, scenes - begin),
            asked.seed + k,
            narrower=SHORT if asked.short or asked.balances else {},
        )
        plan = with_law(plan, asked.seed + k) if asked.law != "hertz" else plan
        if asked.balances:
            off.append(balances(plan, 1e-6))
            known = (found := np.concatenate(off))[np.isfinite(found)]
            print(
                f"{len(found)} scenes, {len(known)} motions; energy lacking over the tolerance: "
                f"median {np.median(known):.2g}, 99 % {np.quantile(known, 0.99):.2g}, worst "
                f"{known.max():.2g}"
            )
            for row in np.flatnonzero(off[-1] > 2.0 * ALLOWED):
                print(f"- seed {asked.seed + k}, motion {row}: {off[-1][row]:.3g}")
        else:
            compared = (
                against_reference if asked.reference else partial(against_itself, alone=asked.alone)
            )
            parts.append(compared(plan))
            print(report(merged(parts)))
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
