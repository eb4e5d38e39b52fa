"""Roots between two ends, beside SciPy's to the last bit."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import brentq

from uqsphere.uq.roots import root

FUNCTIONS: dict[str, Callable[[float, float], float]] = {
    "cubic": lambda x, a: x**3 - a,
    "exponential": lambda x, a: math.exp(x) - 1.0 - a,
    "steep": lambda x, a: math.tanh(50.0 * (x - a)),
    "flat": lambda x, a: (x - a) ** 9,
    "jump": lambda x, a: math.copysign(1.0, x - a),
    "cusp": lambda x, a: math.copysign(abs(x - a) ** 0.2, x - a),
    "next to nothing": lambda x, a: 1e-170 * (x - a) ** 3,  # whose products underflow
}


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("asked", [{}, {"xtol": 1e-9, "rtol": 1e-12}, {"xtol": 1e-13, "rtol": 1e-14}], ids=str)
def test_every_step_is_that_of_scipy(name: str, asked: dict[str, float]) -> None:
    rng, found = np.random.default_rng(0), 0
    for a, *ends in rng.uniform(-3.0, 3.0, (200, 3)).tolist():
        known: list[list[float]] = [[], []]
        ways: list[Callable[..., float]] = [brentq, root]
        answers = []
        for seen, way in zip(known, ways, strict=True):

            def told(x: float, seen: list[float] = seen, a: float = a) -> float:
                seen.append(x)
                return FUNCTIONS[name](x, a)

            try:
                answers.append(way(told, *ends, **asked))
            except (ValueError, RuntimeError) as error:
                answers.append(type(error))
        assert known[0] == known[1]
        assert answers[0] == answers[1]
        found += isinstance(answers[1], float)
    assert found or name == "flat"  # which takes more than 100 steps where next to nothing is allowed


def test_what_is_no_number_is_refused() -> None:
    with pytest.raises(ValueError, match="no number at 0"):
        root(lambda x: math.nan if x == 0.0 else x, -1.0, 1.0)
