"""How often the 95 % interval of a surrogate holds the model's answer at new points inside its domain, and its width.

python -m tests.campaigns.surrogates
"""

from __future__ import annotations

import numpy as np

from tests.campaigns.chaos import MODELS
from uqsphere import analysis
from uqsphere.uq.law import make_law

#: rough ones in three uniform inputs
ROUGH = {
    "kink": lambda x: np.abs(x[:, 0] - 0.3) + x[:, 1] * x[:, 2],
    "two kinks": lambda x: np.abs(x[:, 0] + x[:, 1] - 0.8) + np.maximum(x[:, 2] - 0.5, 0.0),
    "jump": lambda x: (x[:, 0] + 0.5 * x[:, 1] > 0.8) + x[:, 1] * x[:, 2],
    "quotient": lambda x: (1.0 + x[:, 1]) / (0.1 + x[:, 0]) + x[:, 2],
    "steep quotient": lambda x: (x[:, 1] + x[:, 2]) / (0.02 + x[:, 0] * x[:, 1]),
}
NAMES = ("borehole", "OTL circuit", "piston", "wing weight", "g-function", "Ishigami", "flood", "Friedman", *ROUGH)
SIZES, SEEDS, POINTS = (64, 128), (1, 2, 3), 3000


def row(name: str, size: int) -> str:
    """Shares of points held, and mean half-widths over the 95 % quantile of the errors, by seed."""
    laws = MODELS[name].laws if name in MODELS else (make_law("uniform", {}, 0.0, 1.0),) * 3
    function, held, wide = ROUGH[name] if name in ROUGH else MODELS[name].function, [], []
    for seed in SEEDS:
        rng = np.random.default_rng(100 * seed + size)
        x, new = (np.column_stack([law.ppf(rng.random(n)) for law in laws]) for n in (size, POINTS))
        found = analysis.chaos(x, function(x), {f"x{k}": law for k, law in enumerate(laws)})
        new = new[((new >= found.lowest) & (new <= found.highest)).all(axis=1)]
        value, low, high = found.predict(new)
        truth = function(new)
        held.append(f"{100.0 * np.mean((low <= truth) & (truth <= high)):.1f}")
        wide.append(f"{np.mean(high - low) / 2.0 / np.quantile(np.abs(truth - value), 0.95):.2f}")
    held.append(f"leaves {found.response.error:.1g}")
    return f"| {name} | {size} | {', '.join(held)} | {', '.join(wide)} |"


if __name__ == "__main__":
    print("| model | rows | points held [%] | half-width over the errors' 95 % |\n|---|---|---|---|")
    for size in SIZES:
        for name in NAMES:
            print(row(name, size), flush=True)
