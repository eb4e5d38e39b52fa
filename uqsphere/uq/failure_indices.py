"""What drives a failure: the change of its probability per standard deviation that an input's centre is moved by.

Failure has the conditional probability T = P(failure | inputs), F_S(demand) or its complement, the strength being
integrated.
"""

from __future__ import annotations

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.estimate import Estimate, from_replicates
from uqsphere.uq.joint import Joint


def score_gradients(inputs: Joint, scores: Array) -> Array:
    """-∂ ln f/∂s (n, d) of the joint density f of the dependent normal scores s (n, d).

    The scores themselves where inputs are independent, R⁻¹ s under the Gaussian copula.
    """
    found = np.array(scores, dtype=float)
    for columns, copula in inputs.blocks:
        found[:, list(columns)] = copula.score_gradient(scores[:, list(columns)])
    return found


def sway_estimates(probabilities: Array, gradients: Array, moved: Array | None = None) -> list[Estimate]:
    """Change of the probability of failure per standard deviation that an input's centre is moved by.

    For T (R, n) and gradients (R, n, d) of `score_gradients` it is E[T g_i], by the density that moves with the
    law's centre in normal scores, everything that ties inputs staying as it is; T is taken about its mean, which
    changes nothing but the noise.  `moved` (R, n, d) adds what a strength that is tied to the inputs does meanwhile.
    """
    method = "derivative of the density"
    about = probabilities - probabilities.mean()
    rows = (about[:, :, None] * gradients + (0.0 if moved is None else moved)).mean(axis=1)
    return [from_replicates(rows[:, i], method, probabilities.size) for i in range(rows.shape[1])]
