"""Random test sets through the reader of a study: does the range of the share broken hold the
truth, does any crash?

2 to 60 tests of a Weibull, a lognormal or a normal law, on spheres of one or two sizes, some
stopped at the failure before them or at a force; the share that the true law breaks at a random
force is 0.5 % to 80 %.  The size laws are the product's: the weakest link for Weibull, equal
tension else.

    python -m tests.campaigns.strengths [--repetitions N]
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from tests.campaigns import options, table, tell
from uqsphere.errors import StudyError
from uqsphere.study import load_study
from uqsphere.uq import LawError
from uqsphere.uq.fitting import possible_laws

STUDY = """
sphere = {{ E = "60 GPa", nu = 0.25, density = "2700 kg/m3", radius = "6 mm" }}
rig = {{ kind = "platens" }}
platens = {{ material = "steel", force = "2 kN" }}
[limits.a]
criterion = "core_tension"
[limits.a.strength]
file = "t.csv"
force = "F"
force_unit = "N"
diameter = "D"
diameter_unit = "mm"
platens = "steel"
censored = "s"
fit = "{}"
unbiased = {}
"""
LAWS = ("weibull", "lognormal", "normal")
STOPS = ("none", "at a failure", "at a force")


def one_set(rng: np.random.Generator, folder: Path) -> tuple[str, str, bool | None, str]:
    """Law, kind of stops, whether the range holds or None where the set is refused, and why it
    was.
    """
    kind = LAWS[rng.integers(3)]
    n = int(np.exp(rng.uniform(np.log(2), np.log(60.5))))
    shape = np.exp(rng.uniform(np.log(2.5), np.log(15.0)))
    law: Any = {
        "weibull": stats.weibull_min(shape),
        "lognormal": stats.lognorm(1.2 / shape),
        "normal": stats.norm(1.0, min(1.2 / shape, 0.25)),
    }[kind]
    sizes = np.where(rng.random(n) < 0.5, 10.0, 14.0) if rng.random() < 0.5 else np.full(n, 12.0)
    exponent = 2.0 - 3.0 / shape if kind == "weibull" else 2.0
    unit = law.rvs(n, random_state=rng)
    stops = "none" if kind == "normal" else STOPS[rng.integers(3)]
    stopped = np.zeros(n, dtype=bool)
    if stops == "at a failure":
        order, last = np.argsort(unit), max(2, int(rng.uniform(0.3, 1.0) * n))
        stopped[order[last:]] = True
        unit[stopped] = unit[order[last - 1]] if last <= n else 0.0
    elif stops == "at a force":
        limit = law.ppf(rng.uniform(0.3, 0.95))
        stopped, unit = unit > limit, np.minimum(unit, limit)
    force = 2000.0 * unit * (sizes / 12.0) ** exponent
    rows = [f"{f!r},{d},{int(s)}" for f, d, s in zip(force.tolist(), sizes, stopped, strict=True)]
    (folder / "t.csv").write_text("\n".join(["F,D,s", *rows]))
    share = np.exp(rng.uniform(np.log(0.005), np.log(0.8)))
    unbiased = "true" if kind != "normal" and rng.random() < 0.5 else "false"
    try:
        text = STUDY.format(kind, unbiased)
        study = load_study(
            folder / "s.toml", text=text if kind != "normal" else text.replace('censored = "s"', "")
        )
        tested = study.limits[0].tested
        assert tested is not None
        assert tested.law is not None
        at = np.array([2000.0 * law.ppf(share) * (tested.diameter / 0.012) ** tested.exponent])
        found = [float(one.cdf(at)[0]) for one in possible_laws(tested.law, 1000, rng)]
    except (StudyError, LawError) as error:
        return kind, stops, None, " ".join(str(error).rpartition(": ")[2].split()[-7:])
    low, high = np.quantile(found, [0.025, 0.975])
    return kind, stops, bool(low <= share <= high), ""


def main(arguments: Sequence[str] | None = None) -> int:
    given = options(__doc__, arguments, repetitions=200)
    rng = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as folder:
        sets = [one_set(rng, Path(folder)) for _ in range(given.repetitions)]
    rows = []
    for name in ("all", *LAWS, *STOPS):
        own = [one for one in sets if name in ("all", *one[:2])]
        held = [one[2] for one in own if one[2] is not None]
        rows.append([name, str(len(own)), str(len(own) - len(held)), f"{np.mean(held):.3f}"])
    tell(table(["sets", "number", "refused", "hold"], rows))
    for why in sorted({one[3] for one in sets} - {""}):
        tell(f"refused {sum(one[3] == why for one in sets)}: … {why}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
