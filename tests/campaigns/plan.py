"""Does the number to use depend on the plan?  Each study is judged with its plan moved over
two decades; the number of each aim must stay.

Beside shipped studies: a mill ball dropped on a granite lump, and a granite lump thrown on
manganese steel, each with contacts that yield by default and elastic by name.

    python -m tests.campaigns.plan [STUDY ...] [--plans 5]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.campaigns import options, table, tell
from uqsphere.models.model import Model
from uqsphere.propagation.design import Design
from uqsphere.propagation.grow import grow
from uqsphere.propagation.verdict import judge
from uqsphere.study import load_study, shipped_studies

#: random free number of each study: key, planned mean, unit and coefficient of variation
FREE = {
    "granite": ("striker.speed", 0.5, "m/s", 0.02),
    "limestone_margin": ("striker.speed", 0.3, "m/s", 0.03),
    "limestone_chute": ("rig.drop_height", 1.0, "m", 0.1),
    "limestone_drop_weight": ("hammer.drop_height", 12.0, "mm", 0.04),
    "ball": ("hammer.drop_height", 2.0, "m", 0.1),
    "lump": ("rig.speed", 10.0, "m/s", 0.05),
}
ELASTIC = 'contact.law = "hertz"\n'
BALL = """
sphere = { material = "granite", radius = { dist = "normal", mean = "12.5 mm", sd = "1 mm", \
lower = "10 mm", upper = "15 mm" } }
rig = { kind = "drop_weight" }
hammer = { material = "steel", shape = "ball", diameter = "75 mm", \
drop_height = { dist = "normal", mean = "2 m", cov = 0.1 } }
anvil = { material = "manganese_steel" }
limits.broken = { quantity = "specific_energy_sphere", aim = "break", target = 0.2, \
strength = { dist = "lognormal", mean = "130 J/kg", cov = 0.6 } }
margins = { solve = "hammer.drop_height", between = ["0.2 m", "20 m"] }
"""
LUMP = """
sphere = { material = "granite", radius = "12.5 mm" }
rig = { kind = "impact", speed = { dist = "normal", mean = "30 m/s", cov = 0.05 } }
target = { material = "manganese_steel", kind = "thick" }
limits.broken = { quantity = "specific_energy_sphere", aim = "break", target = 0.1, \
strength = { dist = "lognormal", mean = "130 J/kg", cov = 0.4 } }
margins = { solve = "rig.speed", between = ["5 m/s", "150 m/s"] }
analysis.failure_modes = "given"
"""
OWN = {
    "ball": BALL,
    "ball, elastic": BALL + ELASTIC,
    "lump": LUMP,
    "lump, elastic": LUMP + ELASTIC,
}
STUDIES = [*(name for name in FREE if name not in OWN), *OWN]
LOOSE = "analysis.accuracy={ mean = 0.1, quantile = 0.2, sobol = 0.2, probability = 0.05 }"


def main(arguments: Sequence[str] | None = None) -> int:
    asked = options(__doc__, arguments, words=STUDIES, plans=5)
    head = ["study", "aim", *(f"{x:.3g} of the plan" for x in _factors(asked.plans))]
    rows: list[list[str]] = []
    for name in asked.words or STUDIES:
        rows += _numbers(name, asked.plans)
        tell(table(head, rows[-1:]))
    print(table([*head, "largest / smallest", "governs"], rows))
    return 0


def _factors(plans: int) -> list[float]:
    return np.geomspace(0.1, 10.0, plans).tolist()


def _numbers(name: str, plans: int) -> list[list[str]]:
    """A row an aim: its number to use by plan, and what governs."""
    numbers: dict[str, list[float | None]] = {}
    governing: dict[str, dict[str, None]] = {}
    path, text = shipped_studies().get(name, Path("study.toml")), OWN.get(name)
    key, planned, unit, cov = FREE[name.removesuffix(", elastic")]
    for factor in _factors(plans):
        free = f'{{ dist = "normal", mean = "{factor * planned:.6g} {unit}", cov = {cov} }}'
        study = load_study(path, [LOOSE, f"{key}={free}"], text=text)
        design = Design.of(study)
        with Model(design.judged) as model:
            judged, _ = judge(model, grow(design, model, seconds=600.0))
        for aim in judged:
            assert aim.line is not None
            doubt = aim.line.governing
            numbers.setdefault(aim.aim.word, []).append(aim.line.number)
            word = f"{doubt.limit.name}, {doubt.code} {doubt.detail}".strip()
            governing.setdefault(aim.aim.word, {})[word] = None
    rows = []
    for aim, values in numbers.items():
        texts = ["none" if value is None else f"{value:.4g}" for value in values]
        finite = [value for value in values if value is not None]
        spread = "–"
        if finite and len(finite) == len(values):
            spread = f"{max(finite) / min(finite):.3f}"
        rows.append([name, aim, *texts, spread, "; ".join(governing[aim])])
    return rows


if __name__ == "__main__":
    sys.exit(main())
