"""A strength that `uqsphere fit` has found: the draws of a fracture energy at the diameter of the sphere."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from uqsphere.errors import AccessError, FolderError
from uqsphere.study.columns import inside_folder
from uqsphere.study.faults import Findings, Misplaced, Place, Raw
from uqsphere.study.numbers import Reading
from uqsphere.study.particle_tables import ENERGY_OF, FitStrengthTable
from uqsphere.study.scene import Scene
from uqsphere.study.tables import read_table
from uqsphere.uq.families.observed import DRAWN
from uqsphere.uq.law import Law

#: draws of a fit that a study carries: the Monte Carlo error of a mean of 200 laws is 7 % of what tests leave open;
#: a diameter counts as tested within this factor
_DRAWS: Final = 200
_BESIDE: Final = 1.01


def is_fit(raw: object) -> bool:
    """Whether a strength is what `uqsphere fit` has found, by its folder."""
    return isinstance(raw, Mapping) and "fit" in raw and not {"dist", "tests", "file"} & set(raw)


def read_fit_strength(
    raw: Mapping[str, Raw], place: Place, quantity: str, scene: Scene, findings: Findings
) -> Reading | None:
    """The fracture energy of the sphere by the draws of a fit, at its mean diameter; None, with the faults noted.

    Each draw is one of the laws that the tests allow, and the law in force their mean.
    """
    table = read_table(FitStrengthTable, raw, findings, place)
    if quantity != ENERGY_OF["sphere"]:
        said = 'a fit is of the energy that the particle itself takes up: criterion = "specific_energy"'
        findings.add((*place, "fit"), f'{said} with energy_is = "sphere" goes with it')
    radius = scene.mean("sphere.radius")
    if not table.fit or radius is None or not findings.clean(place):
        return None
    from uqsphere.feed.fit import Posterior, read_fit

    with findings.noting(place):
        folder = inside_folder(table.fit, findings.folder, "fit")
        try:
            posterior, about = Posterior.load(folder), read_fit(folder)
        except (FolderError, AccessError) as error:
            raise Misplaced(str(error), "fit") from None
        diameter = 2.0 * radius
        low, high = about.tested
        if not low / _BESIDE <= diameter <= high * _BESIDE:
            found = (
                f"the sphere of {1e3 * diameter:.4g} mm lies beyond the tests, {1e3 * low:.4g} to {1e3 * high:.4g} mm"
            )
            findings.warn((*place, "fit"), f"{found}: its strength is extrapolated")
        draws = posterior.as_laws(diameter, _DRAWS)
        if not draws:
            raise Misplaced(f"no size class of the fit is near {1e3 * diameter:.4g} mm", "fit")
        tests = 0.0 if about.tests is None else float(about.tests.particles)
        law = Law(family=DRAWN, parameters={"tests": tests}, draws=draws)
        return Reading(value=law, made_up=about.made_up)
    return None
