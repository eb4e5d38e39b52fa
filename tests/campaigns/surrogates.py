"""How often the 95 % interval of a surrogate holds the model's answer at new points inside its domain, and its width.

python -m tests.campaigns.surrogates
"""

from __future__ import annotations

import numpy as np

from tests.campaigns.chaos import MODELS
from uqsphere import analysis

NAMES = ("borehole", "OTL circuit", "piston", "wing weight", "g-function", "Ishigami", "flood", "Friedman")
SIZES, SEEDS, POINTS = (64, 128), (1, 2), 3000


def row(name: str, size: int) -> str:
    """Shares of points held, and mean half-widths over the 95 % quantile of the errors, by seed."""
    model, held, wide = MODELS[name], [], []
    for seed in SEEDS:
        rng = np.random.default_rng(100 * seed + size)
        x, new = (np.column_stack([law.ppf(rng.random(n)) for law in model.laws]) for n in (size, POINTS))
        found = analysis.chaos(x, model.function(x), {f"x{k}": law for k, law in enumerate(model.laws)})
        new = new[((new >= found.lowest) & (new <= found.highest)).all(axis=1)]
        value, low, high = found.predict(new)
        truth = model.function(new)
        held.append(f"{100.0 * np.mean((low <= truth) & (truth <= high)):.1f}")
        wide.append(f"{np.mean(high - low) / 2.0 / np.quantile(np.abs(truth - value), 0.95):.2f}")
    return f"| {name} | {size} | {', '.join(held)} | {', '.join(wide)} |"


if __name__ == "__main__":
    print("| model | rows | points held [%] | half-width over the errors' 95 % |\n|---|---|---|---|")
    for size in SIZES:
        for name in NAMES:
            print(row(name, size), flush=True)
