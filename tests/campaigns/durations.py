"""The equivalent contact duration against quadrature of dense histories, over random scenes of bars
and other rigs; and the contact time of other rigs against a ten-thousandth of the tolerance.

python -m tests.campaigns.durations --rows 300 --seed 1
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from tests.campaigns import options
from tests.campaigns.sweep import design, with_law
from uqsphere.mechanics.integrator.solve import Motion, motions, solve
from uqsphere.mechanics.scene import Scene

Array = npt.NDArray[np.float64]
#: spheres that are not too light, so that a history has some hundred steps
SHORT = {"mu": (3e-4, 1e3, True), "theta": (1e-3, 30.0, True), "ratio": (0.1, 10.0, True)}
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)


def scenes(rows: int, seed: int, law: str = "hertz") -> list[Scene]:
    """Random scenes of two bars, of every pulse and every end."""
    found = design(rows, seed, narrower=SHORT)
    return found if law == "hertz" else with_law(found, seed)


def rig_scenes(rows: int, seed: int) -> list[Scene]:
    """Random scenes of weights and of bars that are struck, elastic and yielding: `rows` of
    each.
    """
    rng = np.random.default_rng(seed)

    def spread(low: float, high: float) -> Array:
        return np.asarray(low * (high / low) ** rng.random(rows))

    found = []
    for law in ("hertz", "plastic"):
        sphere = {
            "sphere.E": spread(1e10, 1e11),
            "sphere.nu": rng.uniform(0.1, 0.4, rows),
            "sphere.radius": spread(2e-3, 2e-2),
            "sphere.density": spread(1e3, 4e3),
        }
        steel = {
            "E": np.full(rows, 2.1e11),
            "nu": np.full(rows, 0.3),
            "density": np.full(rows, 7850.0),
            "yield_strength": spread(4e8, 2e9),
        }

        def body(table: str, steel: dict[str, Array] = steel, **more: Array) -> dict[str, Array]:
            return {f"{table}.{name}": column for name, column in {**steel, **more}.items()}

        weight = {
            **sphere,
            **body("hammer", mass=spread(0.1, 5.0)),
            "hammer.speed": spread(0.3, 3.0),
        }
        diameter = 2.5 * sphere["sphere.radius"]
        rod = body("rod", diameter=diameter, length=spread(0.5, 3.0))
        drop = Scene(columns={**weight, **body("anvil")}, rig="drop_weight", contact_law=law)
        bar = body("target", diameter=diameter, length=spread(0.05, 1.0))
        struck = Scene(
            columns={**sphere, "rig.speed": spread(0.5, 5.0), **bar},
            rig="impact",
            contact_law=law,
            options={"target.kind": "bar"},
        )
        load = Scene(columns={**weight, **rod}, rig="load_cell", contact_law=law, horizon=0.05)
        found += [drop, load, struck]
    return found


def quadrature(course: Motion) -> float:
    """t_eq/t_c of a motion that ends with its record: Gauss over every step, the tail between
    infinite bars closed.

    Between bars the impulse runs to the first loss of contact after the largest mean force, unless
    the whole record counts.
    """
    scene, row, unit = course.scene, course.row, course.unit
    times, _ = _points(course, course.end)
    width = 4.0 * float(np.diff(times).max())
    top, at = _largest(course, lambda forces: forces.mean(axis=1), times, width)
    end, lost = course.end, False
    if scene.rig == "bars" and not scene.whole_record:
        counted = [time for time in _losses(course, times) if at <= time < course.horizon]
        end, lost = min([*counted, course.horizon]) / unit, bool(counted)
    times, weights = _points(course, end)
    impulse = float(course.forces_at(times).mean(axis=1) @ weights)
    if scene.rig == "bars" and np.isinf(scene.record_end[row]) and not lost:
        last = np.array([course.horizon])
        if course.forces_at(last).min() > 1e-9 * top:  # no face was lost
            above = course.states_at(last)[0, :2] - _dents(course, times, width)
            impulse += float(scene.scales.impedance[row]) * 0.5 * float(above.sum())
    return impulse / top / unit


def _losses(course: Motion, times: Array) -> list[float]:
    """Times [s] at which the force of a face falls to zero, between the points `times`."""
    found = []
    pressed = course.forces_at(times) > 0.0
    for face in (0, 1):
        for i in np.flatnonzero(pressed[:-1, face] & ~pressed[1:, face]):
            low, high = times[i], times[i + 1]
            for _ in range(60):
                middle = 0.5 * (low + high)
                if course.forces_at(np.array([middle]))[0, face] > 0.0:
                    low = middle
                else:
                    high = middle
            found.append(float(high))
    return sorted(found)


def _points(course: Motion, end: float) -> tuple[Array, Array]:
    """Gauss points [s] of all steps of a motion up to `end`, over t_c, and their weights [s]."""
    begin, until = course.start, np.minimum(course.start + course.length, end)
    inside = until > begin
    middle, half = 0.5 * (begin + until)[inside, None], 0.5 * (until - begin)[inside, None]
    times, weights = middle + half * _NODES, half * _WEIGHTS
    return times.ravel() * course.unit, weights.ravel() * course.unit


def _largest(
    course: Motion, of: Callable[[Array], Array], times: Array, width: float
) -> tuple[float, float]:
    """The largest value of a function of both forces and its time: about the highest node, on finer
    and finer grids.
    """
    at, top = times[int(np.argmax(of(course.forces_at(times))))], 0.0
    for _ in range(40):
        grid = np.clip(at + width * np.linspace(-1.0, 1.0, 41), 0.0, course.end * course.unit)
        value = of(course.forces_at(grid))
        at, width, top = grid[int(np.argmax(value))], 0.2 * width, max(top, float(value.max()))
    return top, float(at)


def _dents(course: Motion, times: Array, width: float) -> Array:
    """What stays of both faces, by their law at the largest force of each; nothing yet of one that
    still yields.
    """
    law = course.scene.struck.face
    if law is None or course.forces is None:
        return np.zeros(2)
    face = law.at(course.row)
    tops = [_largest(course, lambda forces, k=k: forces[:, k], times, width)[0] for k in (0, 1)]  # type: ignore[misc]
    dents = [float(face.pressed(face.depth_at(np.array([top]))).dent_left[0]) for top in tops]
    return np.where(
        course.forces_at(np.array([course.end * course.unit]))[0] < np.array(tops), dents, 0.0
    )


def compare(found: list[Scene], tolerance: float, fidelity: str = "full") -> Array:
    """Errors over the tolerance of all rows with an answer that no check doubts: of t_eq, or of t_c
    where t_eq is shorter.

    The integrator keeps approaches to a share of alpha_c: what a record of a hundredth of t_c has
    of impulse is less.
    """
    errors, kept, finer = [], ("contact_duration",), max(1e-2 * tolerance, 1e-12)
    for scene in found:
        answers = solve(scene, fidelity=fidelity, tolerance=tolerance, quantities=kept)
        rows = np.flatnonzero((answers.status == 0) & (answers.grazes == 0.0))
        for course in motions(scene, rows, fidelity=fidelity, tolerance=finer, quantities=kept):
            if isinstance(course, Motion):
                expected = quadrature(course) * course.unit
                answer = answers.values["contact_duration"][course.row]
                errors.append(abs(answer - expected) / max(expected, course.unit) / tolerance)
    return np.array(errors)


def partings(found: list[Scene], tolerance: float) -> Array:
    """Errors over the tolerance of `loaded_time`, asked for alone, of all rows with an answer that
    no check doubts.
    """
    errors = []
    for scene in found:
        answers, closer = (
            solve(scene, tolerance=asked, quantities=("loaded_time",))
            for asked in (tolerance, 1e-4 * tolerance)
        )
        known = (answers.status == 0) & (closer.status == 0) & (answers.grazes == 0.0)
        times, exact = (of.values["loaded_time"][known] for of in (answers, closer))
        errors.append(np.abs(times / exact - 1.0) / tolerance)
    return np.concatenate(errors)


def main() -> None:
    given = options(__doc__, rows=300, seed=1)
    for what, found in (
        ("elastic", scenes(given.rows, given.seed)),
        ("yielding", scenes(given.rows, given.seed, "p")),
        ("rigs", rig_scenes(given.rows // 6, given.seed)),
    ):
        errors = compare(found, 1e-8)
        print(
            f"{what}: {len(errors)} rows, error over tolerance: median {np.median(errors):.2g}, "
            f"99 % {np.quantile(errors, 0.99):.2g}, largest {errors.max():.2g}"
        )
    for tolerance in (1e-4, 1e-6, 1e-8):
        errors = partings(rig_scenes(4 * given.rows, given.seed), tolerance)
        print(
            f"contact time of rigs at {tolerance:g}: {len(errors)} rows, error over tolerance: "
            f"99 % {np.quantile(errors, 0.99):.2g}, largest {errors.max():.2g}"
        )


if __name__ == "__main__":
    main()
