"""The same strength, at the same probability of fracture, as a striker's speed, a closing speed, a drop and a blow.

    python -m reports.same_strength              # the tables as Markdown; some four minutes

Three shipped strengths are carried from their tests to free impact on a thick plate of steel (210 GPa), square on, as a
service of the study they come from: by the criterion itself (equal local stress), by energy and by centre tension.  The
last columns are those of a drop weight on a rigid anvil that is far heavier than the sphere: the force between its two
faces at which the mean sphere is strained alike, and the energy, twice that of free impact at equal force, (R15).  Each
row stands twice: with elastic contacts, and with those of the library that yield, in the test as in the machine.  The
second table has what faces that yield do to the speed for a force, (R23).
"""

from __future__ import annotations

import sys
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.optimize import brentq

import uqsphere
from uqsphere.arrays import Array
from uqsphere.mechanics.criteria import CRITERIA, demand
from uqsphere.mechanics.outputs import at_force, columns_of
from uqsphere.mechanics.rigs import GRAVITY
from uqsphere.model import scene_of, solve_scene
from uqsphere.results import Results
from uqsphere.study import Study, shipped_studies, with_number
from uqsphere.study.text import toml_text

#: the plate that every sphere strikes
PLATE: Final = {"kind": "thick", "E": "210 GPa", "nu": 0.3, "density": "7850 kg/m3"}
#: accuracies at which the figures of the tables stand, in minutes rather than hours
_ROUGH: Final = {"mean": 0.5, "quantile": 0.5, "sobol": 0.5, "probability": 0.5, "curve": 0.01}


@dataclass(frozen=True, kw_only=True)
class Case:
    """A shipped study and a limit of it, and the probabilities of its rows; `striker`: whether bars are solved for."""

    study: str
    limit: str
    about: str
    probabilities: tuple[float, ...]
    striker: bool = True
    law: str = "hertz"


CASES: Final = (
    Case(study="limestone_margin", limit="whole", about="limestone 20 mm, core tension by tests",
         probabilities=(0.001, 0.01, 0.5, 0.95)),
    Case(study="granite", limit="crushing", about="granite 20 mm, p_max", probabilities=(0.002, 0.01, 0.5)),
    Case(study="limestone_ball_slow", limit="crushing", about="limestone 16 mm, p_max 2.5 GPa",
         probabilities=(0.01, 0.5, 0.99), striker=False),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Row:
    """One probability of one case: speeds [m/s], forces at the closing speed and of a weight [N], its energy [J, J/kg]."""

    case: Case
    probability: float
    striker: float | None
    local: float
    energy: float
    centre: float
    force: float
    pressed: float
    weight: float
    specific: float

    def text(self) -> str:
        """A row of the table."""
        striker = "–" if self.striker is None else f"{self.striker:.3g}"
        drop = f"{self.local:.3g} ({self.local**2 / (2.0 * GRAVITY):.3g} m)"
        law = {"hertz": "elastic", "plastic": "yields"}[self.case.law]
        cells = (self.case.about, law, f"{100.0 * self.probability:g} %", striker, drop, f"{self.energy:.3g}",
                 f"{self.centre:.3g}", f"{1e-3 * self.force:.3g} kN",
                 f"{1e-3 * self.pressed:.3g} kN, {self.weight:.3g} J, {self.specific:.3g} J/kg")  # fmt: skip
        return f"| {' | '.join(cells)} |"


def with_service(case: Case, folder: Path, evaluations: int) -> Path:
    """The shipped study with the limit asked of a free impact as well, for so many evaluations; where it stands."""
    source = shipped_studies()[case.study]
    for data in source.parent.glob("*.csv"):
        (folder / data.name).write_bytes(data.read_bytes())
    with source.open("rb") as file:
        content = tomllib.load(file)
    own = content["limits"][case.limit]
    asked = {"for_probability": list(case.probabilities)}
    content["contact"] = {"law": case.law}
    if case.law == "hertz":
        own.pop("strength_is", None)
    content["limits"] = {"struck": {**own, "in": "plate"}, **({case.limit: own} if case.striker else {})}
    tied = content.get("dependence", [])
    old = f"limits.{case.limit}.strength"
    both = [{**tie, "of": [new if name == old else name for name in tie["of"]]}
            for tie in tied for new in ("limits.struck.strength", *([old] if case.striker else []))]  # fmt: skip
    content["service"] = {
        "plate": {"kind": "impact", "speed": "5 m/s", "target": PLATE, "solve": "speed", "between": ["0.2 m/s", "90 m/s"]}
    }
    if case.striker:
        content["margins"] = {"solve": "striker.speed", "between": ["0.05 m/s", "20 m/s"], **asked}
    else:
        for table in ("bars", "striker", "pulse"):
            del content[table]
        content["rig"] = {"kind": "none"}
        content["limits"]["struck"]["platens"] = {key: PLATE[key] for key in ("E", "nu")}
        content["margins"] = asked
    content["analysis"] = {"accuracy": _ROUGH, "quantities": ["P_max"], "methods": ["pce"], "ways": "given",
                           "budget": {"evaluations": evaluations, "time": "10 min"}}  # fmt: skip
    path = folder / f"{case.study}.toml"
    path.write_text(toml_text({**content, "dependence": both}), encoding="utf-8")
    return path


def rows_of(case: Case, evaluations: int = 400_000) -> list[Row]:
    """The rows of a case, from a run of its study."""
    with tempfile.TemporaryDirectory() as place:
        study = uqsphere.load_study(with_service(case, Path(place), evaluations))
        results = uqsphere.run(study, out=Path(place) / "run").results
    plate, service = study.services["plate"], results.services["plate"]
    carried = service.limits["struck"].carried.values
    rows = []
    for p in case.probabilities:
        key = f"{p:.15g}"
        local = service.margins["struck"].values[key].number
        force, pressed, weight, specific = _at_means(plate, local)
        rows.append(
            Row(case=case, probability=p, striker=_striker(results, case, key), local=local,
                energy=carried["energy"][key].number, centre=carried["centre"][key].number,
                force=force, pressed=pressed, weight=weight, specific=specific)  # fmt: skip
        )
    return rows


def _striker(results: Results, case: Case, key: str) -> float | None:
    return results.margins[case.limit].values[key].number if case.striker else None


def _at_means(study: Study, speed: float) -> tuple[float, float, float, float]:
    """Peak force of the mean sphere at a closing speed; of a weight on a rigid anvil that strains it alike the force, the
    energy and that per mass.

    One force alone has another tension on the axis than two, (R20): the forces differ where that is the demand.
    """
    (limit,) = (one for one in study.limits if one.name == "struck")
    scene = scene_of(study, {"rig.speed": np.array([speed])})
    values = solve_scene(scene, "full", tolerance=1e-9, threads=1, quantities=("P_max", limit.quantity)).values
    force, known = float(values["P_max"][0]), {**columns_of(scene), "face": scene.struck.face}

    def beyond(pressed: float) -> float:
        squeezed = at_force(np.full(1, pressed), known)
        if limit.quantity not in scene.demands:
            return float(squeezed[limit.quantity][0] - values[limit.quantity][0])
        key, parameters = scene.demands[limit.quantity]
        return float(demand(CRITERIA[key], squeezed, parameters)[0] - values[limit.quantity][0])

    pressed = float(brentq(beyond, 0.2 * force, 5.0 * force, rtol=1e-12))
    squeezed = at_force(np.full(1, pressed), known)
    energy = float(squeezed["energy"][0] + squeezed["dissipated"][0])
    return force, pressed, energy, energy / float(scene.scales.mass[0])


# --- faces that yield ---------------------------------------------------------------------------------------


def speeds_for_forces(study: Study, forces: Array) -> Array:
    """Closing speeds (n,) [m/s] at which the mean sphere has peak forces [N], by bisection of the scenes themselves."""
    low, high = np.full(forces.shape, np.log(1e-2)), np.full(forces.shape, np.log(290.0))
    for _ in range(45):
        middle = 0.5 * (low + high)
        scene = scene_of(study, {"rig.speed": np.exp(middle)})
        found = solve_scene(scene, "full", tolerance=1e-9, threads=1, quantities=("P_max",)).values["P_max"]
        low, high = np.where(found < forces, middle, low), np.where(found < forces, high, middle)
    return np.asarray(np.exp(0.5 * (low + high)))


def yielding(study: Study, numbers: Mapping[str, float]) -> Study:
    """A study of free impact whose faces yield, with more numbers (SI) by their paths."""
    moved = replace(study, options={**study.options, "contact.law": "plastic"})
    for path, value in numbers.items():
        moved = with_number(moved, path, value)
    return moved


def yielding_rows(forces: Sequence[float]) -> list[tuple[float, ...]]:
    """Force [N]; closing speed by Hertz; with a target of 834 MPa; with a limestone pole of onset 0.75, hardness 1.5 GPa."""
    with tempfile.TemporaryDirectory() as place:
        study = uqsphere.load_study(with_service(CASES[0], Path(place), 1)).services["plate"]
    steel = yielding(study, {"target.yield_strength": 834e6})
    rock = yielding(study, {"sphere.onset_pressure": 0.75e9, "sphere.hardness": 1.5e9})
    wanted = np.array(forces)
    columns = [wanted, *(speeds_for_forces(one, wanted) for one in (study, steel, rock))]
    return [tuple(row) for row in np.stack(columns, axis=1).tolist()]


def tables() -> tuple[list[Row], list[tuple[float, ...]]]:
    """Rows of both tables."""
    rows = [row for case in CASES for law in ("hertz", "plastic") for row in rows_of(replace(case, law=law))]
    limestone = [row.force for row in rows if row.case == CASES[0]]
    return rows, yielding_rows(limestone)


def main(arguments: Sequence[str]) -> int:
    """Print both tables."""
    rows, yields = tables()
    header = ("strength", "contacts", "p(break)", "striker, m/s", "equal local stress, m/s (drop)", "equal energy", "centre", "force",
              "drop weight")  # fmt: skip
    print(f"| {' | '.join(header)} |\n|{'---|' * len(header)}")
    print("\n".join(row.text() for row in rows))
    print("\n| force | elastic, m/s | steel of 834 MPa | limestone crushes, 0.75/1.5 GPa |\n|---|---|---|---|")
    for force, elastic, *others in yields:
        cells = (f"{speed:.3g} ({100.0 * (speed / elastic - 1.0):+.0f} %)" for speed in others)
        print(f"| {1e-3 * force:.3g} kN | {elastic:.3g} | {' | '.join(cells)} |")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
