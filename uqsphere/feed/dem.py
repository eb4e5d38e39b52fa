"""Draws of a feed's parameters as DEM programs name them; nothing is written where a format was not seen.

Every export has draws.csv: a row per draw, so that the parameters keep how they hang together, and as draw 0 the
medians of each, which belong together in no draw.  Names of interfaces were read in ansys/pyrocky 3416499
(src/ansys/rocky/app/ra_particle.pyi) and in LIGGGHTS-PFM d075b97 (src/fix_break_particle.cpp,
fix_template_fragments.cpp, particleSizeDistribution.cpp); EDEM's labels and files were not seen.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Places
from uqsphere.feed.answers import FeedEntry
from uqsphere.feed.fit import UNITS, Posterior

#: shares that a law of another kind meets Vogel and Peukert's at: one standard deviation about the median
_MATCHED: Final = (0.1587, 0.8413)
#: n of the fragments that LIGGGHTS makes; the smallest of them is the smallest radius
_FRAGMENTS: Final = (2, 5, 10, 20)
#: setter of Rocky, column of the draws, unit of the setter, factor from SI
Setter = tuple[str, str, str, float]
_TAVARES: Final[tuple[Setter, ...]] = (
    ("SetTavaresEInf", "e_inf", "J/kg", 1.0), ("SetTavaresD0", "d0", "m", 1.0), ("SetTavaresPhi", "phi", "", 1.0),
    ("SetTavaresSigmaSquared", "sigma_squared", "", 1.0), ("SetTavaresRatioEmax", "ratio", "", 1.0),
    ("SetTavaresGamma", "gamma", "", 1.0), ("SetTavaresA", "A", "%", 100.0), ("SetTavaresB", "b", "", 1.0),
)  # fmt: skip
_ABT10: Final[tuple[Setter, ...]] = (
    ("SetAbt10SelectFunctionCoefficient", "S", "kg/J", 1.0),
    ("SetAbt10ReferenceMinimumSpecificEnergy", "e_min_ref", "J/kg", 1.0),
    ("SetAbt10ReferenceSize", "L_ref", "m", 1.0), ("SetAbt10MaximumT10Value", "A", "%", 100.0),
)  # fmt: skip
#: units of the columns that are made here
_MADE: Final = {
    "broken": "1", "A": "1", "alpha": "1", "sigma_squared": "1", "ratio": "1", "S": "kg/J", "e_min_ref": "J/kg",
    "L_ref": "m", "f_mat": "kg/(J m)", "threshold": "J m/kg", "F0": "N", "m": "1", "f_mat_force": "N-based, 1",
    "b_implied": "kg/J", "e_inf_rig": "J/kg",
}  # fmt: skip


class NotThere(ValueError):
    """A program has no place for what was fitted."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Draws:
    """Chosen draws: columns by name (SI) with their units, and what is to be said of them.

    columns : name -> (N + 1,); the first row is the medians, no draw
    numbers : (N,) numbers of the draws in draws.csv of the fit
    """

    columns: Mapping[str, Array]
    units: Mapping[str, str]
    laws: tuple[str, ...]
    numbers: Places
    notes: tuple[str, ...]


def spread_draws(broken: Array, count: int) -> Places:
    """Places of `count` draws at even shares of the sorted share broken, (D,).

    >>> spread_draws(np.array([0.3, 0.1, 0.2, 0.4]), 2).tolist()
    [1, 0]
    """
    if not 1 <= count <= len(broken):
        raise NotThere(f"found {count} draws: from 1 to {len(broken)} are there")
    at = ((np.arange(count) + 0.5) / count * len(broken) - 0.5).astype(np.int64)
    return np.asarray(np.argsort(broken, kind="stable")[at])


def choose(
    posterior: Posterior, entry: FeedEntry, table: Mapping[str, Array], count: int, rig_factor: float | None = None
) -> Draws:
    """`count` draws of a feed, spread over its broken share, with the product's numbers.

    table : columns of feed-draws.csv;  rig_factor : E_inf is multiplied by it beside what it is
    """
    places = spread_draws(table["broken"], count)
    numbers = table["draw"][places].astype(np.int64)
    some = posterior.at(numbers - 1)
    columns: dict[str, Array] = {"broken": table["broken"][places]}
    columns |= {name: values for name, values in some.draws.items() if np.isfinite(values).any()}
    columns |= {name.partition(" [")[0]: table[name][places] for name in table if name not in ("draw", "broken")}
    if "sigma" in columns:
        columns["sigma_squared"] = columns["sigma"] ** 2
        columns["ratio"] = np.full(count, posterior.ratio)
    if rig_factor is not None and "e_inf" in columns:
        columns["e_inf_rig"] = columns["e_inf"] * rig_factor
    units = {**UNITS, **_MADE, "b": "kg/J" if entry.form == "jk" else "1"}
    with_medians = {name: np.append(np.nanmedian(values), values) for name, values in columns.items()}
    return Draws(
        columns=with_medians, units={name: units.get(name, "J/kg") for name in columns},
        laws=tuple(some.which.tolist()), numbers=numbers, notes=_notes(posterior, entry, rig_factor),
    )  # fmt: skip


def _notes(posterior: Posterior, entry: FeedEntry, rig_factor: float | None) -> tuple[str, ...]:
    notes = ["THE TESTS ARE MADE UP: these are no numbers of a rock"] if entry.made_up else []
    notes += [
        f"study {entry.hash[:12] or 'unknown'}, seed {entry.seed}, size law {posterior.size}, law {posterior.law}",
        "draw 0 holds the median of each parameter and is no draw; the others weigh the same",
        f"sizes tested {1e3 * posterior.tested[0]:.4g} to {1e3 * posterior.tested[1]:.4g} mm",
        "energies are the particle's own",
        "sigma_squared is the square of sigma; A is a share here and per cent in Rocky",
    ]
    if posterior.ratio == 4.0:
        notes.append("E_max/E50 = 4 is called Rocky's default from memory, not checked at the source")
    if "e_inf" in posterior.draws:
        said = "none applied: e_inf is the particle's energy" if rig_factor is None else f"{rig_factor:g}: e_inf_rig"
        notes.append(f"rig factor 1 + k_p/k_s of the test rig, where a program multiplies by it itself: {said}")
    return tuple(notes)


def draws_csv(draws: Draws) -> str:
    """draws.csv: notes as comments, then draw, law and the parameters with their units."""
    text = io.StringIO()
    text.writelines(f"# {note}\n" for note in draws.notes)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["draw", "number_in_fit", "law", *(f"{name} [{draws.units[name]}]" for name in draws.columns)])
    for row in range(len(draws.numbers) + 1):
        of = ["", "medians"] if row == 0 else [int(draws.numbers[row - 1]), draws.laws[row - 1]]
        values = ["" if math.isnan(v[row]) else repr(float(v[row])) for v in draws.columns.values()]
        writer.writerow([row, *of, *values])
    return text.getvalue()


def _only(draws: Draws, law: str) -> list[int]:
    """Rows of the draws of a law, medians left out."""
    return [k + 1 for k, name in enumerate(draws.laws) if name == law]


# --- Rocky --------------------------------------------------------------------------------------------------


def rocky(draws: Draws, entry: FeedEntry, size: str) -> str:
    """rocky_breakage.py: draws as input variables of a project, and the setters of PyRocky.

    Raises NotThere for a law or a size law that Rocky's models do not have.
    """
    columns, notes = dict(draws.columns), list(draws.notes)
    rows, model = _only(draws, "lognormal"), "professor_tavares"
    if rows:
        setters = _tavares_setters(columns, entry, size, notes)
    else:
        rows, model, setters = _only(draws, "vogel_peukert"), "ab_t10", _ABT10
        if not rows:
            raise NotThere('Rocky has no Weibull law: fit with law = "lognormal" or "vogel_peukert"')
        reference = entry.reference_size
        columns |= {"L_ref": np.full(len(draws.laws) + 1, reference), "S": columns["f_mat"] * reference,
                    "e_min_ref": columns["threshold"] / reference}  # fmt: skip
        notes.append("P = 1 - exp(-S (L/L_ref) e_cum) of ab_t10: from memory, not checked at the source")
    if len(rows) < len(draws.laws):
        notes.append(f"{len(draws.laws) - len(rows)} draws of another law are left out: Rocky has no place for them")
    if entry.curve_law == "beta":
        notes.append("alpha_n and beta_n have no setter in PyRocky: enter them by hand")
    elif entry.curve:
        notes.append(f'Rocky has no curve "{entry.curve_law}": choose its distribution model by hand')
    notes += [
        "Rocky breaks convex polyhedra only, with the hysteretic linear spring as normal force",
        "SetTavaresMinimumEnergy and SetMinimumSizeRatio are left at the project's own",
    ]
    setters = tuple(one for one in setters if one[1] in columns)
    table = [[float(columns[name][row] * factor) for _, name, _, factor in setters] for row in rows]
    return _rocky_text(model, setters, table, notes, entry)


def _tavares_setters(columns: dict[str, Array], entry: FeedEntry, size: str, notes: list[str]) -> tuple[Setter, ...]:
    """Setters of the Tavares model that the draws have values for; E_inf by the rig factor where one is asked for."""
    if size != "tavares":
        raise NotThere(f'Rocky\'s size law is "tavares", the fit has "{size}": fit again with size = "tavares"')
    if not math.isfinite(float(columns["ratio"][0])):
        raise NotThere("Rocky's law has an upper bound E_max: fit with a ratio, 4 say")
    columns["e_inf"] = columns.get("e_inf_rig", columns["e_inf"])
    if entry.form.startswith("tavares"):
        return _TAVARES
    notes.append(
        f"A and b of the form {entry.form} are not Tavares' A and b': left at Rocky's own, enter yours by hand"
    )
    return tuple(one for one in _TAVARES if one[1] not in ("A", "b"))


def _rocky_text(
    model: str, setters: Sequence[Setter], table: Sequence[Sequence[float]],
    notes: Sequence[str], entry: FeedEntry,
) -> str:  # fmt: skip
    lines = ['"""Breakage parameters for Rocky, through PyRocky: apply(project, "name of the particle", draw=1).', ""]
    lines += [f"{note.replace(chr(92), '/')}." for note in notes]
    lines += ['"""', "", "SETTERS = ("]
    lines += [f"    ({setter!r}, {f'uq_{name}'!r}, {unit or None!r})," for setter, name, unit, _ in setters]
    lines += [")", "# one row per draw, in the units of the setters", "DRAWS = ("]
    lines += [f"    ({', '.join(repr(value) for value in row)},)," for row in table]
    lines += [
        ")", "", "",
        "def apply(project, particle, draw=1):",
        "    variables = project.GetInputVariables()",
        "    p = project.GetStudy().GetParticleCollection().GetParticle(particle)",
        f"    p.SetBreakageModel({model!r})",
    ]  # fmt: skip
    if model == "professor_tavares" and entry.form.startswith("tavares"):
        lines.append(f"    p.SetT10Formula({'it10E_50b' if entry.form == 'tavares' else 'it10E_fract'!r})")
    if entry.curve_law == "beta":
        lines.append("    p.SetDistributionModel('incomplete_beta')")
    lines += [
        "    for (setter, name, unit), value in zip(SETTERS, DRAWS[draw - 1]):",
        "        variables.CreateVariable(name, value)",
        "        getattr(p, setter)(name, *([unit] if unit else []))",
        "",
    ]
    return "\n".join(lines)


# --- LIGGGHTS-PFM --------------------------------------------------------------------------------------------


def liggghts(draws: Draws, posterior: Posterior, entry: FeedEntry) -> dict[str, str]:
    """liggghts_NN.in for every draw: the lines of breakage of an input script.

    Draws of Vogel and Peukert's law enter as they are; others by the energies that break 16 and 84 % at the reference
    size; a Weibull law of weakest links by its force, exactly.
    """
    size, found = entry.reference_size, {}
    some = posterior.at(draws.numbers - 1)
    low, high = (some.energy_at(share, size) for share in _MATCHED)
    first, last = (-math.log1p(-share) for share in _MATCHED)
    modulus = entry.particles["E"] / (1.0 - entry.particles["nu"] ** 2) * entry.share
    force = some.force(size, modulus, entry.particles["density"], entry.share)
    top = draws.columns.get("A")
    for k, law in enumerate(draws.laws):
        notes = [
            *draws.notes,
            f"draw {k + 1} of {len(draws.laws)}, number {int(draws.numbers[k])} of the fit, law {law}",
        ]
        if law == "weibull" and posterior.size == "weakest_link":
            m, f_s = float(draws.columns["modulus"][k + 1]), float(force[k])
            criterion = f"fMat {size ** (2.0 * m - 3.0)!r} force_threshold {f_s!r} {m!r}"
            slope = math.nan
            notes.append(
                f"force of half a contact on this partner: E* {modulus / 1e9:.4g} GPa; F0 at {1e3 * size:.4g} mm"
            )
        else:
            if law == "vogel_peukert":
                slope, least = (float(draws.columns[name][k + 1]) for name in ("f_mat", "threshold"))
            else:
                slope = float((last - first) / (high[k] - low[k]) / size)
                least = max(float(low[k]) - first / (slope * size), 0.0) * size
                notes.append(f"Vogel and Peukert through the 16 and 84 % energies of this draw at {1e3 * size:.4g} mm")
            criterion = f"fMat {slope!r} energy_threshold {least!r}"
        if not math.isnan(slope):
            implied = f"implied b = 3600 fMat d = {3600.0 * slope * size:.4g} t/kWh at {1e3 * size:.4g} mm"
            if entry.form == "jk" and top is not None:
                measured = 3600.0 * float(draws.columns["b"][k + 1])
                implied += f", measured {measured:.4g}: one exponent serves strength and t10"
            notes.append(implied)
        largest = 1.0 if top is None else float(top[k + 1])
        if top is None:
            notes.append("no A was given: breakage_index 1.0 is its largest value")
        family = " ".join(map(str, _FRAGMENTS))
        lines = [
            *(f"# {note}" for note in notes),
            "# t_n of this program is trr with alpha = 1; damage adds up linearly over the blows",
            "pair_style gran model hertz/break tangential history",
            f"fix pts all particletemplate/fragments 11 atom_type 1 density constant {entry.particles['density']!r} "
            f"breakage_index {largest!r} {1.0 / _FRAGMENTS[-1]!r} tn_family {len(_FRAGMENTS)} {family} maxattempt 200",
            "fix pdd all particledistribution/discrete 1 1 pts 1.0",
            f"fix brk all break/particle seed {100003 + 2 * k} distributiontemplate pdd every 1 {criterion} "
            f"min_radius {0.5 * entry.classes[-1].upper!r} breakability uniform",
        ]
        found[f"liggghts_{k + 1:02d}.in"] = "\n".join(lines) + "\n"
    return found


# --- EDEM -----------------------------------------------------------------------------------------------------


def edem(draws: Draws, entry: FeedEntry, size: str) -> str:
    """edem_tavares.csv: what is to be typed in, a row per draw and symbol.

    Raises NotThere for a law or a size law that the Tavares model does not have.
    """
    rows = _only(draws, "lognormal")
    if not rows or size != "tavares":
        raise NotThere('EDEM\'s Tavares model is lognormal with size = "tavares": fit again so')
    symbols = {"E_inf": "e_inf", "d0": "d0", "phi": "phi", "gamma": "gamma", "sigma": "sigma"}
    if entry.form.startswith("tavares"):
        symbols |= {"A": "A", "b": "b"}
    if "e_inf_rig" in draws.columns:
        symbols["E_inf (1 + k_p/k_s)"] = "e_inf_rig"
    text = io.StringIO()
    text.writelines(f"# {note}\n" for note in (*draws.notes, "EDEM's labels and files were not seen: type these in"))
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["draw", "symbol", "value", "unit", "source"])
    particle = entry.particles["E"] / (1.0 - entry.particles["nu"] ** 2)
    for row in rows:
        for symbol, name in symbols.items():
            if name in draws.columns:
                value = float(draws.columns[name][row])
                writer.writerow([row, symbol, repr(value), draws.units[name], "posterior of the tests"])
        writer.writerow([row, "k_p", repr(particle), "Pa", "E/(1 - nu^2) of the particles"])
    return text.getvalue()


def export(
    target: str, posterior: Posterior, entry: FeedEntry, table: Mapping[str, Array], count: int,
    rig_factor: float | None = None,
) -> dict[str, str]:  # fmt: skip
    """The files of an export by their names; raises NotThere where the program has no place for what was fitted."""
    draws = choose(posterior, entry, table, count, rig_factor)
    files = {"draws.csv": draws_csv(draws)}
    if target == "rocky":
        files["rocky_breakage.py"] = rocky(draws, entry, posterior.size)
    elif target == "liggghts":
        files |= liggghts(draws, posterior, entry)
    elif target == "edem":
        files["edem_tavares.csv"] = edem(draws, entry, posterior.size)
    return files
