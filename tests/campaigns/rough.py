"""A contact time that jumps: what a plain polynomial chaos makes of it, what the engine answers, and the truth.

Near a grazing separation the spheres just lose contact, or just keep it until the next swing: the contact time jumps.
A plain expansion is smooth there, and says nothing of it.

    python -m tests.campaigns.rough [--quick]
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from tests.campaigns import table, tell
from uqsphere.arrays import Array

if TYPE_CHECKING:
    from uqsphere.study import Study
    from uqsphere.uq.expansion import Chaos

#: infinite bars, so that nothing but the pulse and the sphere's own swing decides
STUDY: Final = """title = "Alumina ball, 20 mm, between PMMA bars: a grazing separation"
seed = 4

[sphere]
material = "alumina"
radius = "10 mm"

[bars]
material = "pmma"
diameter = "20 mm"
infinite = true

[striker]
speed  = { dist = "normal", mean = "5 m/s", cov = 0.02 }
length = { dist = "normal", mean = "LENGTH mm", cov = 0.02 }

[model]
fidelity = "full"

[limits.long]
quantity = "contact_time"
strength = "LEVEL us"

[analysis]
quantities = ["contact_time"]
quantiles = [0.05, 0.5, 0.75, 0.95]
accuracy = { mean = 0.01, quantile = 0.02, sobol = 0.01, probability = 0.02 }
budget = { evaluations = EVALUATIONS, time = "60 min" }
"""
#: mean length of the striker [mm], and a contact time just below the upper branch [us]
LENGTH: Final = 130.0
LEVEL: Final = 450.0
#: points that both expansions are fitted to
POINTS: Final = 256
_DEGREES: Final = range(1, 11)
_INPUTS: Final = ("striker.speed", "striker.length")
_LEVELS: Final = (0.05, 0.5, 0.75, 0.95)


def study_text(evaluations: int) -> str:
    """The study as a file holds it."""
    numbers = {"LENGTH": f"{LENGTH:g}", "LEVEL": f"{LEVEL:g}", "EVALUATIONS": str(evaluations)}
    found = STUDY
    for name, number in numbers.items():
        found = found.replace(name, number)
    return found


def plain_chaos(points: Array, outputs: Array, degree: int) -> Chaos:
    """Least squares in all products of Hermite polynomials up to a total degree: germ points (n, d), outputs (n,).

    Raises ValueError where there are fewer points than terms.
    """
    from uqsphere.uq.expansion import Chaos, Piece, hyperbolic_indices, orthonormal_values
    from uqsphere.uq.expansion.germs import products

    d = points.shape[1]
    indices = hyperbolic_indices(d, degree, 1.0, len(outputs))
    if indices is None:
        raise ValueError(f"degree {degree} has more terms than there are points ({len(outputs)})")
    values = products([orthonormal_values("normal", points[:, j], degree) for j in range(d)], indices)
    coefficients = np.asarray(np.linalg.lstsq(values.T, outputs, rcond=None)[0], dtype=np.float64)
    piece = Piece(coefficients=coefficients, multi_indices=indices, transform=None)
    return Chaos(pieces=(piece,), border=None, germs=("normal",) * d, cross_validation_error=1.0,
                 samples=len(outputs), solver="least squares")  # fmt: skip


def _times(study: Study, physical: Array) -> Array:
    """Contact times (...,) [s] at speeds and lengths (..., 2), SI."""
    from uqsphere.model import evaluate

    rows = physical.reshape(-1, 2)
    values = {name: rows[:, k] for k, name in enumerate(_INPUTS)}
    found = evaluate(study, values, ("contact_time",), tolerance=study.model.tolerance)
    return np.asarray(found["contact_time"], dtype=float).reshape(physical.shape[:-1])


def _truth(study: Study, count: int) -> tuple[dict[str, tuple[float, float]], Array]:
    """Answers with their half-widths from `count` base points in each of 16 replicates, and the times (n,)."""
    from scipy.special import ndtri

    from uqsphere.runner.schedule import REPLICATES
    from uqsphere.uq.describe import describe
    from uqsphere.uq.estimate import Estimate, from_replicates
    from uqsphere.uq.indices import Blocks, sampled_indices, uniform_halves

    inputs, blocks = study.inputs().only(_INPUTS), Blocks(inputs_count=2)
    physical = np.stack([
        blocks.mix(*(inputs.physical(np.asarray(ndtri(half))) for half in
                     uniform_halves(blocks, count=count, seed=77, task="rough: truth", replicate=k)))
        for k in range(REPLICATES)
    ])  # fmt: skip
    times = _times(study, physical)
    found = describe(times[:, :, 0], quantiles=_LEVELS)
    indices = sampled_indices(times, blocks)
    beyond = from_replicates((times[:, :, 0] > LEVEL * 1e-6).mean(axis=1), "", times.size)
    answers: dict[str, Estimate] = {"sd": found.sd, "probability": beyond}
    answers |= {f"quantile {p:g}": found.quantiles[p] for p in _LEVELS}
    for order, row in (("first", indices.first), ("total", indices.total)):
        answers |= {f"{order} {name}": e for name, e in zip(_INPUTS, row, strict=True)}
    return {name: (float(e.value or 0.0), e.half_width) for name, e in answers.items()}, times[:, :, [0, 3]].ravel()


def _answers_of(chaos: Chaos) -> tuple[dict[str, float], Array]:
    """The same off an expansion: distribution from 2^17 points, indices off its coefficients; and the values."""
    from scipy.special import ndtri

    from uqsphere.uq.expansion import chaos_moments, index_of, predict
    from uqsphere.uq.points import sobol_points

    u = sobol_points(dimension=2, count=2**17, seed=77, task="rough: expansion", replicate=0)
    values = predict(chaos, np.asarray(ndtri(u)))
    found = {"sd": chaos_moments(chaos)[1], "probability": float((values > LEVEL * 1e-6).mean())}
    found |= {f"quantile {p:g}": float(np.quantile(values, p)) for p in _LEVELS}
    together = index_of(chaos, [0, 1])
    for j, name in enumerate(_INPUTS):
        found[f"first {name}"] = index_of(chaos, [j])
        found[f"total {name}"] = found[f"first {name}"] + together
    return found, values


def _engine(study: Study) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
    """Answers of a run, and what it says of its surrogate, its evaluations and what it missed."""
    from uqsphere.runner.api import run

    with tempfile.TemporaryDirectory() as folder:
        results = run(study, out=Path(folder) / "rough").results.document()
    entry, shares = results["quantities"]["contact_time"], results["sensitivity"]["contact_time"]
    answers = {"sd": entry["sd"], "probability": results["limits"]["long"]["exceedance"]}
    answers |= {f"quantile {p}": estimate for p, estimate in entry["quantiles"].items()}
    for order in ("first", "total"):
        answers |= {f"{order} {name}": shares[order][name] for name in _INPUTS}
    kept = {name: {key: e[key] for key in ("value", "low", "high")} for name, e in answers.items()}
    return kept, {
        "evaluations": sum(results["model"]["evaluations"].values()), "missed": results["accuracy"]["missed"],
        "surrogate": {key: shares["surrogate"].get(key) for key in ("error", "usable", "reason")},
    }  # fmt: skip


def measure(quick: bool) -> str:
    """Truth by heavy sampling, the best plain expansion, the engine's own expansion, and a run of the engine."""
    from uqsphere.runner.evaluate import draw
    from uqsphere.study import load_study
    from uqsphere.uq.expansion import fit_chaos, judge, validation_error

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "grazing.toml"
        path.write_text(study_text(40_000 if quick else 300_000), encoding="utf-8")
        study = load_study(path)
        tell("the truth")
        truth, times = _truth(study, 256 if quick else 4096)
        tell("expansions")
        inputs = study.inputs().only(_INPUTS)
        points = draw(inputs, seed=1, task="rough: fit", start=0, count=POINTS, replicates=1)
        held = draw(inputs, seed=1, task="rough: held out", start=0, count=POINTS * 4, replicates=1)
        germs, unseen = points.scores[0], held.scores[0]
        fitted, checked = _times(study, points.inputs[0]), _times(study, held.inputs[0])
        plain = {degree: plain_chaos(germs, fitted, degree) for degree in _DEGREES}
        errors = {degree: validation_error(chaos, unseen, checked) for degree, chaos in plain.items()}
        degree = min(errors, key=lambda k: errors[k])
        own = fit_chaos(germs, fitted, ("normal", "normal"))
        own_error = validation_error(own, unseen, checked)
        tell("a run of the engine")
        engine, about = _engine(study)
        found, values = _answers_of(plain[degree])
    # values that no scene has: in the widest gap between neighbouring true ones, ends left out
    ordered = np.sort(times)
    inner = ordered[len(ordered) // 50 : -(len(ordered) // 50)]
    at = int(np.diff(inner).argmax())
    low, high = float(inner[at]), float(inner[at + 1])
    margin = 0.02 * (high - low)
    inside = float(np.mean((values > low + margin) & (values < high - margin)))
    rows = []
    for name, (true, width) in truth.items():
        shown = f"P(contact time > {LEVEL:g} us)" if name == "probability" else name
        ours = engine[name]
        rows.append((shown, f"{_shown(name, true)} ± {_shown(name, width)}", _shown(name, found[name]),
                     _off(name, found[name], true), _shown(name, ours["value"]),
                     f"{_shown(name, ours['low'])} to {_shown(name, ours['high'])}",
                     _off(name, ours["value"], true)))  # fmt: skip
    header = ("answer", "truth", "plain", "off by", "engine", "95 % interval", "off by")
    return "\n".join([
        f"The contact time jumps from {low * 1e6:.0f} to {high * 1e6:.0f} us. Plain: least squares of total degree "
        f"{degree}, the best of 1 to {_DEGREES[-1]}, from {POINTS} points; it leaves {errors[degree]:.2g} of the "
        f"variance and has {inside:.1%} of its values where there are none. Engine: a run with "
        f"{about['evaluations']:,} evaluations. Truth: {2 * times.size:,} evaluations.",
        "", table(header, rows), "",
        f"The engine's own expansion ({own.solver}) leaves {own_error:.2g}; its verdict: "
        f"{judge(own, own_error).reason}. In the run: {about['surrogate']['reason']}.",
        *(f"Not reached: {told}." for told in about["missed"]),
    ])  # fmt: skip


def _shown(name: str, value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value * 1e6:.1f} us" if name == "sd" or name.startswith("quantile") else f"{value:.4f}"


def _off(name: str, value: float | None, truth: float) -> str:
    """An index is off by a share of the variance, the rest relative to the truth."""
    if value is None:
        return "-"
    return f"{abs(value - truth):.4f}" if name.startswith(("first", "total")) else f"{abs(value / truth - 1.0):.2%}"


if __name__ == "__main__":
    print(measure("--quick" in sys.argv))
