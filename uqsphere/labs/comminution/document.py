"""The input file of the lab: material, tests of particles, feed, product."""

from typing import Annotated, Any, Literal, get_args

from pydantic import Field, model_validator

from uqsphere.documents import Fault
from uqsphere.labs.files import (
    Density,
    Length,
    Mass,
    PoissonRatio,
    Positive,
    Pressure,
    Section,
    Speed,
    TableFile,
    from_library,
    in_unit,
)

#: rigs that record the energy at failure; those, and rigs that record the energy offered
AT_FAILURE = ("platens", "load_cell", "bars")
Rig = Literal["platens", "load_cell", "bars", "drop_weight", "impact", "drop"]
RIGS = get_args(Rig)
#: keys of columns that have an energy, or give it
MEASURED = ("specific_energy", "energy", "speed", "force")
#: parameters of the laws
Parameter = Literal["e_inf", "C", "d0", "phi", "sigma", "modulus", "gamma"]


def _one_of(table: Section, *keys: str) -> str:
    """The one of some keys that a table has; ValueError for none or several."""
    present = [key for key in keys if getattr(table, key)]
    if len(present) != 1:
        raise ValueError(f"exactly one of {', '.join(keys)} is required")
    return present[0]


class Elastic(Section):
    """E, nu and density; omitted ones are those of the material."""

    material: str | None = None
    E: Pressure | None = None
    nu: PoissonRatio | None = None
    density: Density | None = None

    @model_validator(mode="before")
    @classmethod
    def _from_library(cls, data: Any) -> Any:
        return from_library(data, "sphere", "plates", "bars")


class Lognormal(Section):
    """A lognormal prior or scatter: logarithm of the median, and sd of the logarithm."""

    log_mean: float
    log_sd: Positive = Field(allow_inf_nan=True)


class TestsTable(TableFile):
    """Tests of single particles: each row is a blow or a compression; values name columns.

    rig : what the rows were tested in; rig_column : the column that gives it.
    specific_energy, energy, speed, force : exactly one; the unit stands in the heading or in
        `unit`.
    energy_is : `sphere` absorbed by the particle, `contact` by both bodies of the contacts, `input`
        offered.
    particles, broken : for rows that stand for several particles.
    specimen : rows of one name are blows on one particle.
    stiffness : column of measured K_e = E*; without it a force needs `assume_intact = true`.
    partner : what the particles touch; its share of the energy is subtracted.
    ratio : E_max/E50 of the lognormal law.
    gamma : damage exponent, or "fit" to repeated blows.
    """

    file: str
    rig: Rig = "load_cell"
    rig_column: str = ""
    where: dict[str, str | int | float] = Field(default_factory=dict)
    diameter: str = ""
    mesh_lower: str = ""
    mesh_upper: str = ""
    diameter_unit: str = ""
    specific_energy: str = ""
    energy: str = ""
    speed: str = ""
    force: str = ""
    unit: str = ""
    energy_is: Literal["sphere", "contact", "input"] | None = None
    outcome: str = ""
    specimen: str = ""
    blows: str = ""
    particles: str = ""
    broken: str = ""
    mass: str = ""
    mass_unit: str = ""
    stiffness: str = ""
    stiffness_unit: str = ""
    assume_intact: bool = False
    partner: Elastic | None = None
    law: Literal["lognormal", "weibull", "average"] = "average"
    ratio: float = Field(default=4.0, gt=1.0, allow_inf_nan=True)
    size: Literal["tavares", "king", "power", "class"] = "tavares"
    gamma: Positive | Literal["fit"] = "fit"
    prior: dict[Parameter, Lognormal] = Field(default_factory=dict)
    synthetic: bool = False

    @property
    def measured(self) -> str:
        """The key that names a column of energies; ValueError for none or several."""
        return _one_of(self, *MEASURED)

    @model_validator(mode="after")
    def _one_of_each(self) -> "TestsTable":
        measured = self.measured
        if not (self.diameter or (self.mesh_lower and self.mesh_upper)):
            raise ValueError("diameter, or mesh_lower and mesh_upper, is required")
        if not (self.outcome or self.broken):
            raise ValueError("outcome, or broken with particles, is required")
        if measured == "force" and not (self.stiffness or self.assume_intact):
            raise ValueError(
                "a force needs the stiffness of each particle (stiffness = COLUMN), or "
                "assume_intact = true"
            )
        if measured in ("specific_energy", "energy") and not self.energy_is:
            raise ValueError('energy_is is required: "sphere", "contact" or "input"')
        if isinstance(self.gamma, float) and not 0.5 < self.gamma < 50.0:
            raise Fault(
                f"must be between 0.5 and 50 (published: 3 to 5.4), not {self.gamma:g}", "gamma"
            )
        return self


class SizesTable(TableFile):
    """The feed by mass: a law or a sieve table; classes from `top` down by the factor `ratio`.

    d63, d50, n, sd : numbers of the law; 0, as of `top`, where none is given.
    """

    law: Literal["rosin_rammler", "gaudin_schuhmann", "lognormal", "table"]
    d63: Length = 0.0
    d50: Length = 0.0
    n: Positive = 0.0
    sd: Positive = 0.0
    top: Length = 0.0
    ratio: float = Field(default=2.0**0.5, gt=1.0)
    classes: int = Field(default=14, ge=1, le=200)
    sieve: str = ""
    sieve_unit: str = ""
    passing: str = ""

    @model_validator(mode="after")
    def _complete(self) -> "SizesTable":
        needs = {
            "rosin_rammler": ("d63", "n", "top"),
            "gaudin_schuhmann": ("n", "top"),
            "lognormal": ("d50", "sd", "top"),
            "table": ("file", "sieve", "passing"),
        }[self.law]
        missing = [key for key in needs if not getattr(self, key)]
        if missing:
            raise Fault(f'law = "{self.law}" requires {" and ".join(missing)}', "law")
        return self


class FeedTable(Section):
    """A feed under blows.

    specific_energy, energy, speed : of one blow, exactly one: J/kg of every size, J, impact speed;
        0 where it is not given.
    impact_surface : what the particles hit.
    rebreak : whether the remaining blows hit fragments, as fresh particles.
    undersize : whether particles below the last sieve break too.
    lot : mass whose scatter is computed.
    fines : size below which the product counts as fines.
    """

    sizes: SizesTable
    blows: int = Field(default=1, ge=1, le=1000)
    specific_energy: Annotated[Positive, in_unit("specific_energy")] = 0.0
    energy: Annotated[Positive, in_unit("energy")] = 0.0
    speed: Speed = 0.0
    impact_surface: Elastic | None = None
    rebreak: bool = False
    undersize: Literal["stays", "breaks"] = "stays"
    lot: Mass | None = None
    fines: Length | None = None

    @model_validator(mode="after")
    def _one_energy(self) -> "FeedTable":
        _one_of(self, "specific_energy", "energy", "speed")
        return self


class ProductTable(Section):
    """t10 = A (1 - exp(-b E)) and the curve of t_n; alpha is a number or scatters."""

    A: Annotated[float, in_unit("number"), Field(gt=0.0, le=1.0)]
    b: Annotated[Positive, in_unit("mass_per_energy")]
    curve: Literal["trr", "milin"] = "trr"
    alpha: Positive | Lognormal = Lognormal(log_mean=-0.5108, log_sd=0.25)


class ComminutionDocument(Section):
    """An input file of `uqsphere comminution fit` and `feed`.

    strength_at : diameter of the particles whose strength is written as draws (default: the middle
        of the tested sizes).
    contact_law : of the shares of offered energies (default: that of a study).
    draws : number of draws.
    """

    title: str = ""
    seed: int = Field(default=1, ge=0)
    material: Elastic
    tests: TestsTable
    feed: FeedTable | None = None
    product: ProductTable | None = None
    strength_at: Length | None = None
    contact_law: Literal["hertz", "plastic"] | None = None
    draws: int = Field(default=4000, ge=200, le=20000)
