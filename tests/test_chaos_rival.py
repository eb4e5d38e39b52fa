"""The peer of the expansions: what was stored is looked up for its own design alone, and counted as it is said."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from tests.campaigns import chaos
from tests.campaigns.chaos import (
    MODELS,
    Measured,
    Rival,
    design,
    fingerprint,
    rival_present,
    same_design,
    stored,
    verdicts,
)


def rival(model: str, samples: int, true: float, told: tuple[float, ...] = (0.0,) * 4) -> Rival:
    """A stored run."""
    return Rival(model=model, samples=samples, seed=1, true=true, seconds=3.0, fits=7, degree=3, norm=0.75,
                 version="1.0", told=told)  # fmt: skip


def test_a_fingerprint_tells_designs_and_models_apart() -> None:
    model = MODELS["Ishigami"]
    points = design(model, 64, 1)
    outputs = model(points)
    known = rival("Ishigami", 64, 1e-3, fingerprint(points, outputs))
    assert same_design(known, points, outputs)
    assert same_design(known, points, outputs * (1.0 + 1e-14))  # another machine's rounding
    other = design(model, 64, 2)
    assert not same_design(known, other, model(other))
    swapped = points[::-1].copy()
    assert not same_design(known, swapped, model(swapped))
    assert not same_design(known, points, 2.0 * outputs)
    assert not same_design(known, points, outputs + 1e-3 * points[:, 0])
    moved = points.copy()
    moved[5, 2] += 1e-3
    assert not same_design(known, moved, outputs)


def test_what_is_stored_is_used_for_its_own_design_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = MODELS["product"]
    points = design(model, 64, 1)
    found = rival("product", 64, 0.125, fingerprint(points, model(points)))
    path = tmp_path / "runs.json"
    path.write_text(json.dumps([asdict(found), asdict(rival("product", 65, 0.5))]), encoding="utf-8")
    assert stored(path)["product", 64, 1] == found
    assert stored(tmp_path / "none.json") == {}
    monkeypatch.setattr(chaos, "stored", lambda: stored(path))
    first, second, another = chaos.measure(["product"], [64, 65], [1, 2])[:3]
    assert (first.rival_true, first.rival_seconds) == (0.125, 3.0)
    assert second.rival_true is None  # of the first seed alone
    assert another.samples == 65
    assert another.rival_true is None  # stored for another design


def test_the_stored_runs_are_those_of_the_designs_of_today() -> None:
    known = stored()
    assert {model for model, _, _ in known} == set(MODELS)
    for (name, samples, seed), one in known.items():
        points = design(MODELS[name], samples, seed)
        assert same_design(one, points, MODELS[name](points)), (name, samples)
        assert 0.0 < one.true <= 1.0
        assert min(one.fits, one.seconds) > 0


def test_no_worse_and_better_are_counted_with_the_tolerance_that_is_said() -> None:
    def pair(ours: float, theirs: float | None) -> Measured:
        return Measured(model="a", samples=64, seed=1, true=ours, reported=ours, seconds=0.1, chosen="",
                        rival_true=theirs, rival_seconds=None)  # fmt: skip

    found = [pair(1e-3, 2e-3), pair(1.04e-3, 1e-3), pair(1.06e-3, 1e-3), pair(2e-11, 1e-11), pair(1e-12, 1e-9),
             pair(1.0, None)]  # fmt: skip
    assert verdicts(found) == (4, 2, 5)


@pytest.mark.skipif(not rival_present(), reason="needs the extra `peers`")
def test_the_peer_has_a_polynomial_exactly() -> None:
    from tests.campaigns.chaos import ChaosModel

    model = ChaosModel(
        name="polynomial", laws=(("uniform", -1.0, 1.0),) * 2,
        function=lambda x: np.asarray(1.0 + x[:, 0] * x[:, 1] + x[:, 1] ** 2),
    )  # fmt: skip
    found = chaos.rival_fit(model, 32, 1)
    assert found.true < 1e-20
    assert found.fits > 3
