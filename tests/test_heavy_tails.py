"""Moments that are not given: those that do not exist, those that are not known, and the scale that is left."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import stdtrit

from uqsphere.arrays import Array
from uqsphere.runner.account import _slowest
from uqsphere.runner.campaign import indices_missed
from uqsphere.runner.questions.distributions import speed_rows
from uqsphere.runner.questions.indices import Sensitivity, _admitted
from uqsphere.uq.describe import describe
from uqsphere.uq.estimate import Absent, Why, absent, exact
from uqsphere.uq.heavy_tails import (
    MEAN,
    VARIANCE,
    HeavyTail,
    half_range,
    heavy_tail,
    widened_share,
    without_moments,
)
from uqsphere.uq.law import Law, make_law
from uqsphere.uq.points import sobol_points
from uqsphere.uq.response import stretched


def tail(law_order: float, growth: float, doubt: float) -> HeavyTail:
    return HeavyTail(
        name="a", law_order=law_order, growth=growth, order=law_order / (growth + doubt), rows=64, doubt=doubt
    )


@pytest.mark.parametrize(
    ("law_order", "growth", "doubt", "moment", "why"),
    [
        (1.5, 1.0, 0.01, VARIANCE, Why.NO_MOMENT),
        (2.4, 1.0, 0.4, VARIANCE, Why.NOT_KNOWN),  # there as far as the growth was seen
        (2.0, 0.95, 0.1, VARIANCE, Why.NO_MOMENT),  # it may well grow in proportion
        (1.0, 0.8, 0.1, MEAN, Why.NOT_KNOWN),
        (2.0, 1.9, 0.2, MEAN, Why.NO_MOMENT),
    ],
)
def test_only_what_the_growth_rules_out_is_said_not_to_exist(
    law_order: float, growth: float, doubt: float, moment: float, why: Why
) -> None:
    reason = tail(law_order, growth, doubt).reason(moment)
    assert reason.why is why
    assert reason.text.startswith(why.value)
    assert ("or up to" in reason.text) == (why is Why.NOT_KNOWN)


def squares(law: Law, rows: int, shift: float) -> HeavyTail:
    """The tail of (shift + x/2)^2, which comes back to its median far below that of x."""
    rng = np.random.default_rng(7)
    x = law.ppf((rng.permutation(rows) + rng.uniform(size=rows)) / rows)
    found = heavy_tail({"a": law}, x[:, None], (shift + 0.5 * x) ** 2 + rng.uniform(size=rows))
    assert found is not None
    return found


@pytest.mark.parametrize(("rows", "shift"), [(2048, 1.0), (8192, 0.5), (8192, 1.0), (32768, 1.4)])
def test_a_mean_that_exists_is_not_denied_where_the_output_turns_within_the_tail(rows: int, shift: float) -> None:
    """Moments below order 2.5 leave a square its mean, though it looks steep on leaving its turning point."""
    law = make_law("student_t", {"dof": 2.5, "location": 0.0, "scale": 1.0})
    found = squares(law, rows, shift)
    assert found.growth > 2.5
    assert found.reason(MEAN).why is Why.NOT_KNOWN
    assert "but not steadily" in found.reason(MEAN).text


@pytest.mark.parametrize("dof", [1.0, 0.8])
def test_a_mean_that_does_not_exist_is_denied_still(dof: float) -> None:
    law = make_law("student_t", {"dof": dof, "location": 0.0, "scale": 1.0})
    found = squares(law, 8192, 0.0)
    assert found.reason(MEAN).why is Why.NO_MOMENT
    assert found.reason(VARIANCE).why is Why.NO_MOMENT


def pareto(order: float, seed: int) -> Array:
    """Samples (16, 4096) of a law that has moments below an order."""
    return np.asarray(np.random.default_rng(seed).uniform(size=(16, 4096)) ** (-1.0 / order))


@pytest.mark.parametrize(("order", "why"), [(0.5, Why.NO_MOMENT), (1.05, Why.UNTOLD)])
def test_samples_alone_do_not_tell_a_law_with_a_mean_from_one_without(order: float, why: Why) -> None:
    """Of order 1.05 the mean is 21, and no sample of this size gives it."""
    samples = next(s for s in (pareto(order, seed) for seed in range(20)) if describe(s).sd.value is None)
    found = without_moments(describe(samples), None, samples)
    assert found.mean.value is None
    assert found.mean.why is why


@pytest.mark.parametrize(
    ("reason", "told"),
    [
        (Absent.because(Why.NO_MOMENT, "a has none"), "does not exist: a has none"),
        (Absent.because(Why.NOT_KNOWN, "too few runs"), "is not known: too few runs"),
        (Absent.because(Why.NO_CONVERGENCE, "one sample"), "does not converge: one sample"),
        ("too few successful samples in a replicate", "is not known"),
    ],
)
def test_a_share_says_of_its_variance_what_is_said_of_the_deviation(reason: Absent | str, told: str) -> None:
    share = widened_share(replace(exact(0.5), low=0.4, high=0.6), absent(reason, "m", 9))
    assert share.reason == f"the variance that it is a share of {told}"


def test_errors_say_what_they_are_over() -> None:
    samples = np.random.default_rng(1).normal(size=(16, 256))
    found = describe(samples)
    kinds = [row.error_kind for row in speed_rows({"y": found}, {}, 4096)]
    assert kinds
    assert all(kind.endswith("over the standard deviation") for kind in kinds)
    gone = without_moments(found, tail(1.5, 1.0, 0.0), samples)
    rows = speed_rows({"y": gone}, {}, 4096)
    assert len(rows) == len(kinds)
    assert all(row.error_kind.endswith("over half the 16-84 % range") for row in rows)
    part: Any = SimpleNamespace(name="sampling", found=SimpleNamespace(history=rows))
    # the part that took longest names its answer whatever this is over
    assert _slowest(part).endswith(" of y")
    assert rows[0].error == pytest.approx(gone.mean.half_width / half_range(samples))


def test_without_a_deviation_the_scale_is_the_range_that_it_is_called() -> None:
    """Bounded values have a deviation, and what they are without bounds has none."""
    values = pareto(1.5, 3)
    held = describe(np.minimum(values, 50.0))
    found = stretched(held, describe(values), values, 64)
    assert found.sd.value is None
    assert found.scale_name == "half the 16-84 % range"
    assert found.scale == half_range(values) < held.scale


@pytest.mark.parametrize(
    ("half", "told"), [(0.33, "half-width 0.33, asked 0.01"), (0.28, "half-width 0.28, asked 0.01")]
)
def test_a_missed_accuracy_has_the_width_that_the_answer_has(half: float, told: str) -> None:
    """Indices of a heavy tail are widened after what they missed was written down."""

    def indices(width: float) -> Sensitivity:
        row = {"a": replace(exact(0.5), low=0.5 - width, high=0.5 + width)}
        return Sensitivity(first=row, total=row, surrogate={}, sampled={}, expanded={}, agree=None, text="",
                           missed=[indices_missed("y", 0.28, 0.01)])  # fmt: skip

    (missed,) = _admitted("y", indices(half), indices(0.28), 0.01).missed
    assert told in missed.text


@pytest.mark.parametrize("count", [64, 512])
def test_a_standard_deviation_without_fourth_moments_holds_what_the_rarest_values_add(count: int) -> None:
    """By the spread of the scramblings alone 80 % of these hold."""
    truth, hits = math.sqrt(3.0 + 1.0 / 12.0), 0
    tail = HeavyTail(name="c", law_order=3.0, growth=1.0, order=3.0)
    for seed in range(60):
        u = np.stack([sobol_points(dimension=2, count=count, seed=seed, task="t", replicate=r) for r in range(16)])
        outputs = u[..., 0] + stdtrit(3.0, u[..., 1])
        found = without_moments(describe(outputs), tail, outputs.ravel()).sd
        hits += found.value is None or found.low <= truth <= found.high
    assert hits >= 55
    light = replace(tail, order=5.0)
    assert without_moments(describe(outputs), light, outputs.ravel()).sd == describe(outputs).sd
