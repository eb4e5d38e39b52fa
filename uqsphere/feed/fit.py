"""What tests of single particles leave open of their fracture energy: the posterior of a law and its size effect.

A `Posterior` is draws of the parameters, which keep how these hang together; whatever is asked of it is asked of every
draw.  It is written as draws.csv, with units in the header, beside fit.json, which says how it came about.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, ValidationError

from uqsphere.arrays import Array, Values
from uqsphere.errors import FolderError
from uqsphere.feed import laws
from uqsphere.files import load_document, read_whole
from uqsphere.uq.families.observed import LOGNORMAL, WEIBULL, WIDTH

#: draws that go on to populations and exports
DRAWS: Final = 4000
#: units of the columns of draws.csv; energies of a size class are e50_1, e50_2, ...
UNITS: Final = {
    "e_inf": "J/kg", "d0": "m", "phi": "1", "C": "J/kg m^phi", "sigma": "1", "modulus": "1", "gamma": "1",
    "f_mat": "kg/(J m)", "threshold": "J m/kg",
}  # fmt: skip
#: a size class answers for diameters within this factor of its own: half a root-two class on either side
_CLASS: Final = 2.0**0.25
DRAWS_FILE, FIT_FILE = "draws.csv", "fit.json"


E = TypeVar("E", bound="Entry")


class Entry(BaseModel):
    """A table of fit.json."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, protected_namespaces=())


class Interval(Entry):
    """Median of a number with its 95 % interval; null, with the reason, where the draws do not settle it."""

    value: float | None = None
    low: float | None = None
    high: float | None = None
    reason: str = ""

    @classmethod
    def of(cls, values: Array, reason: str) -> Interval:
        """Of draws; those that are nan are left out, and the reason is given where none is left."""
        known = values[np.isfinite(values)]
        if known.size == 0:
            return cls(reason=reason)
        low, middle, high = np.quantile(known, [0.025, 0.5, 0.975])
        return cls(value=float(middle), low=float(low), high=float(high))


class ParameterEntry(Entry):
    """A parameter: largest likelihood, posterior, prior, and whether the tests tell it; sds are of its logarithm."""

    unit: str
    posterior: Interval
    likelihood: float | None
    sd: float
    prior: tuple[float, float] | None
    told: bool
    r_hat: float | None = None
    effective: float | None = None


class SizeEntry(Entry):
    """One tested size [m]: its tests, E50 [J/kg] (the median of e*), the energy that breaks half, -d ln E50/d ln d.

    `low_tail`: the energy [J/kg] that breaks 1 %, by every law that is carried.
    """

    diameter: float
    tests: int
    broke: int
    E50: Interval
    half: Interval
    slope: Interval
    low_tail: dict[str, Interval]


class LawEntry(Entry):
    """One law on the same tests: largest ln likelihood, leave-one-out log score, and its share in an average."""

    name: str
    law: str
    ratio: float | None
    log_likelihood: float
    loo: float | None
    weight: float = 0.0
    words: str = ""


class GoodnessEntry(Entry):
    """Largest distance of the law from the Turnbull estimate, and the share of made-up series that lie farther."""

    distance: float | None = None
    p_value: float | None = None
    series: int = 0
    reason: str = ""


class CountsEntry(Entry):
    """What the tests were."""

    specimens: int
    particles: int
    broke: int
    exact: int
    repeated: int
    cell: float = 0.0


class FitEntry(Entry):
    """What fit.json holds; `ratio` null means E_max = inf."""

    law: str
    size: str
    ratio: float | None
    tested: tuple[float, float]
    classes: tuple[float, ...] = ()
    title: str = ""
    seed: int = 0
    made_up: bool = False
    tests: CountsEntry | None = None
    method: str = ""
    converged: bool = True
    parameters: dict[str, dict[str, ParameterEntry]] = {}
    sizes: tuple[SizeEntry, ...] = ()
    laws: tuple[LawEntry, ...] = ()
    goodness: GoodnessEntry = GoodnessEntry()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Posterior:
    """Draws of the parameters of a law of fracture energy that tests allow.

    law : a name of `laws.LAWS`, or "average" over several
    size : a name of `laws.SIZES`; ratio : E_max/E50 of the lognormal law, inf without a bound
    draws : parameter in SI -> (n,), by the names of `UNITS`; nan where the law of the draw has no such parameter
    which : (n,) the law of each draw
    tested : smallest and largest tested size [m]
    classes : sizes [m] of e50_1, e50_2, ... where every size has an E50 of its own
    """

    law: str
    size: str
    ratio: float
    draws: Mapping[str, Array]
    which: npt.NDArray[np.str_]
    tested: tuple[float, float]
    classes: tuple[float, ...] = ()

    def __len__(self) -> int:
        return len(self.which)

    def median(self, diameter: Values) -> Array:
        """E50 [J/kg] (n, ...) at diameters [m]; nan for draws of a law without a size law and between size classes."""
        d = np.asarray(diameter, dtype=float)
        p = {name: self._column(name, d.ndim) for name in self.draws}
        if self.size != "class":
            return np.broadcast_to(laws.median_energy(self.size, d, p), (len(self), *d.shape))
        near = np.abs(np.log(d[..., None] / np.array(self.classes)))
        of = np.stack([self.draws[f"e50_{k + 1}"] for k in range(len(self.classes))], axis=-1)
        known = near.min(axis=-1) <= np.log(_CLASS) * (1.0 + 1e-9)
        return np.where(known, of[:, near.argmin(axis=-1)], np.nan)

    def broken(self, energy: Values, diameter: Values, thresholds: int = 1) -> Array:
        """Probability (n, ...) that so many equal blows of e [J/kg] break a particle of a diameter [m]."""
        e, d = np.broadcast_arrays(np.asarray(energy, dtype=float), np.asarray(diameter, dtype=float))
        reach: Values = 1.0
        if thresholds != 1:
            reach = laws.thresholds(self.draws["gamma"], thresholds)[:, -1].reshape(-1, *(1,) * e.ndim)
        found = np.empty((len(self), *e.shape))
        for name, rows, p in self.by_law(d):
            if laws.LAWS[name].sized:
                bound = np.asarray(reach)[rows] * e if thresholds != 1 else e
            else:
                least = p["threshold"] / d
                bound = least + thresholds * np.maximum(e - least, 0.0)
            found[rows] = laws.broken_share(name, bound, p)
        return found

    def energy_at(self, share: Values, diameter: Values) -> Array:
        """Energy [J/kg] (n, ...) that breaks this share of fresh particles of a diameter [m] in one blow."""
        q, d = np.broadcast_arrays(np.asarray(share, dtype=float), np.asarray(diameter, dtype=float))
        found = np.empty((len(self), *d.shape))
        for name, rows, p in self.by_law(d):
            found[rows] = laws.LAWS[name].quantile(q, p)
        return found

    def slope(self, diameter: Values) -> Array:
        """-d ln E50/d ln d (n, ...) at diameters [m]; nan where there is no size law."""
        d = np.asarray(diameter, dtype=float)
        p = {name: self._column(name, d.ndim) for name in self.draws}
        if self.size == "class":
            return np.full((len(self), *d.shape), np.nan)
        return np.broadcast_to(laws.size_slope(self.size, d, p), (len(self), *d.shape))

    def force(self, reference: float, stiffness: float, density: float, share: float) -> Array:
        """Fs [N] (n,) of (F6) at a reference size [m], E* [Pa] of both contacts: nan but for draws of a Weibull law.

        `share` is the particle's of the energy of a contact; the modulus of the force is the draws' own.
        """
        m = self.draws.get("modulus", np.full(len(self), np.nan))
        scale = self.median(reference) * np.log(2.0) ** (-1.0 / (0.6 * m))
        return laws.force_of_energy(scale / share, reference, stiffness, density)

    def as_laws(self, diameter: float, count: int) -> tuple[tuple[float, ...], ...]:
        """Draws at one diameter [m] as `uqsphere.uq.families.observed` takes them; none between size classes."""
        rows = np.linspace(0, len(self) - 1, min(count, len(self))).astype(int)
        some, found = self.at(rows), np.empty((len(rows), WIDTH))
        for name, where, p in some.by_law(np.asarray(diameter)):
            if name == "lognormal":
                parts = (LOGNORMAL, 0.0, p["median"], p["sigma"], 1.0 / self.ratio)
            elif name == "weibull":
                m_e = 0.6 * p["modulus"]
                parts = (WEIBULL, 0.0, p["median"] * np.log(2.0) ** (-1.0 / m_e), m_e, 0.0)
            else:
                parts = (WEIBULL, p["threshold"] / diameter, 1.0 / (p["f_mat"] * diameter), 1.0, 0.0)
            found[where] = np.stack(np.broadcast_arrays(*parts), axis=-1)
        return () if np.isnan(found).any() else tuple(map(tuple, found.tolist()))

    def at(self, rows: npt.NDArray[np.int64]) -> Posterior:
        """Some of the draws."""
        draws = {name: column[rows] for name, column in self.draws.items()}
        return Posterior(law=self.law, size=self.size, ratio=self.ratio, draws=draws, which=self.which[rows],
                         tested=self.tested, classes=self.classes)  # fmt: skip

    def _column(self, name: str, dims: int) -> Array:
        return self.draws[name].reshape(-1, *(1,) * dims)

    def by_law(self, diameter: Array) -> list[tuple[str, npt.NDArray[np.int64], dict[str, Values]]]:
        """Every law with the places of its draws and its parameters at the diameters."""
        median = self.median(diameter)
        found = []
        for name in dict.fromkeys(self.which.tolist()):
            rows = np.flatnonzero(self.which == name)
            p: dict[str, Values] = {key: self._column(key, diameter.ndim)[rows] for key in laws.LAWS[name].keys}
            found.append((name, rows, {**p, "median": median[rows], "ratio": self.ratio, "diameter": diameter}))
        return found

    def csv(self) -> str:
        """draws.csv: a row per draw, columns with their units."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["draw", "law", *(f"{name} [{UNITS.get(name, 'J/kg')}]" for name in self.draws)])
        columns = [["" if np.isnan(value) else repr(float(value)) for value in part] for part in self.draws.values()]
        writer.writerows(zip(range(1, len(self) + 1), self.which.tolist(), *columns, strict=True))
        return text.getvalue()

    @staticmethod
    def load(folder: Path) -> Posterior:
        """The posterior of a folder that `uqsphere fit` wrote.

        Raises FolderError where it is missing or damaged.
        """
        about = read_fit(folder)
        path = folder / DRAWS_FILE
        try:
            header, *rows = csv.reader(io.StringIO(read_whole(path).decode("utf-8")), strict=True)
            names = [name.partition(" [")[0] for name in header[2:]]
            values = np.array([[float(cell) if cell else np.nan for cell in row[2:]] for row in rows])
            which = np.array([row[1] for row in rows])
        except (ValueError, IndexError, csv.Error) as error:
            raise FolderError(f"{path} is damaged: {error}") from error
        known = {*UNITS, *(f"e50_{k + 1}" for k in range(len(about.classes)))}
        if values.ndim != 2 or values.shape[1] != len(names) or not {*names} <= known or not {*which} <= {*laws.LAWS}:
            raise FolderError(f"{path} is damaged: it is no table of draws as `uqsphere fit` writes it")
        return Posterior(
            law=about.law, size=about.size, ratio=np.inf if about.ratio is None else about.ratio,
            draws=dict(zip(names, values.T, strict=True)), which=which, tested=about.tested, classes=about.classes,
        )  # fmt: skip


def read_entry(kind: type[E], path: Path) -> E:
    """A document of a result folder; raises FolderError where it is missing or damaged."""
    try:
        return kind.model_validate(load_document(path))
    except ValidationError as error:
        first = error.errors()[0]
        raise FolderError(f"{path} is damaged: {'.'.join(map(str, first['loc']))}: {first['msg']}") from error


def read_fit(folder: Path) -> FitEntry:
    """fit.json of a folder; raises FolderError where it is missing or damaged."""
    return read_entry(FitEntry, folder / FIT_FILE)
