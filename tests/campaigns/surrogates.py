"""How often the 95 % interval of a surrogate holds the model's answer at new points inside its domain.

python -m tests.campaigns.surrogates
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from uqsphere import analysis

ANGLE = stats.uniform(-np.pi, 2.0 * np.pi)
MODELS = {
    "Ishigami": ([ANGLE] * 3, lambda a, b, c: np.sin(a) + 7.0 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a)),
    "kink": ([stats.norm()] * 2, lambda a, b: np.maximum(a + 0.5 * b, 0.0) + 0.3 * b),
    "quotient": ([stats.lognorm(0.3)] * 4, lambda a, b, c, d: a * b / c * np.sqrt(d)),
    "jump": ([stats.uniform()] * 2, lambda a, b: (a > 0.4) + b**2),
}
SIZES, SEEDS, POINTS = (64, 256), range(4), 4000


def row(name: str, size: int) -> str:
    """Mean and least share of points held, over the seeds, and the share of points refused."""
    laws, model = MODELS[name]
    held, refused = [], []
    for seed in SEEDS:
        rng = np.random.default_rng(100 * seed + size)
        x, new = (np.column_stack([law.rvs(n, random_state=rng) for law in laws]) for n in (size, POINTS))
        found = analysis.chaos(x, model(*x.T), {f"x{k}": law for k, law in enumerate(laws)})
        inside = ((new >= found.lowest) & (new <= found.highest)).all(axis=1)
        value = found.predict(new[inside])
        truth = model(*new[inside].T)
        held.append(np.mean((value.low <= truth) & (truth <= value.high)))
        refused.append(1.0 - inside.mean())
    return f"| {name} | {size} | {100 * np.mean(held):.1f} | {100 * min(held):.1f} | {100 * np.mean(refused):.1f} |"


if __name__ == "__main__":
    print("| model | rows | points held [%] | of the worst seed | points refused [%] |\n|---|---|---|---|---|")
    for name in MODELS:
        for size in SIZES:
            print(row(name, size), flush=True)
