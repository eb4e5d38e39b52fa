"""The analysis: marginal laws and what the runs leave open of them, dependence, outputs, and what drives them."""

from __future__ import annotations

import csv
import io
import math
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TextIO, TypeAlias, cast

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import UsageError
from uqsphere.files import Json, open_given
from uqsphere.given.answers import (
    TiedPair,
    given_answers,
    left_open,
    odd_pairs,
    rank_correlations,
    tied,
    ties_of,
    with_ties,
)
from uqsphere.study.columns import cell_number
from uqsphere.uq import Joint, Law, LawError
from uqsphere.uq.estimate import Estimate, absent, mean_alone, sd_alone
from uqsphere.uq.expansion.germs import germs_of
from uqsphere.uq.surrogate import Surrogate, law_scores, least_rows, response_from, surrogate_from

#: bytes of a file, and columns that are looked at
_LARGEST: Final = 256 * 1024 * 1024
_MOST_COLUMNS: Final = 128


#: a part of analysis.json
Document: TypeAlias = dict[str, Json]


@dataclass(frozen=True, kw_only=True, eq=False)
class Data:
    """Named columns of one table: inputs (n, d) and outputs (n, q)."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    x: Array
    y: Array


def read_data(path: Path, inputs: Sequence[str], outputs: Sequence[str]) -> Data:
    """Columns of a CSV with a header line.

    Raises AccessError for a file that cannot be read, or is a pipe or a device, and UsageError for one of more than
    256 MiB and for columns that are missing, named twice or hold what is no finite number, with the line.
    """
    names = [*inputs, *outputs]
    if not inputs or not outputs:
        raise UsageError("name at least one input and one output: --inputs a,b --outputs y")
    if len(set(names)) != len(names):
        raise UsageError(f"a column is named twice among {', '.join(names)}")
    if len(names) > _MOST_COLUMNS:
        raise UsageError(f"found {len(names)} columns, at most {_MOST_COLUMNS} are analysed at a time")
    with open_given(path, _LARGEST) as stream, io.TextIOWrapper(stream, "utf-8-sig", newline="") as text:
        try:
            values = _columns(path, text, names)
        except UnicodeDecodeError as error:
            raise UsageError(f"{path} is not UTF-8 text") from error
        except csv.Error as error:
            raise UsageError(f"{path} is no CSV: {error}") from error
    if len(values) < 5:
        raise UsageError(f"{path}: rows found: {len(values)}, at least 5 are needed")
    d = len(inputs)
    return Data(inputs=tuple(inputs), outputs=tuple(outputs), x=values[:, :d], y=values[:, d:])


def _columns(path: Path, text: TextIO, names: Sequence[str]) -> Array:
    """Columns (n, d + q) of a table; of what it holds besides nothing is kept."""
    reader = csv.reader(text, strict=True)
    rows = ([cell.strip() for cell in row] for row in reader if any(map(str.strip, row)))
    header = next(rows, None)
    if header is None:
        raise UsageError(f"{path} is empty")
    places = _places(path, header, names)
    values = array("d")
    for row in rows:
        for name, k in zip(names, places, strict=True):
            cell = row[k] if k < len(row) else ""
            value = cell_number(cell)
            if not math.isfinite(value):
                found = f"column {name!r}: found {cell[:40]!r}, where a finite number is due"
                raise UsageError(f"{path}:{reader.line_num}: {found}")
            values.append(value)
    return np.array(values).reshape(-1, len(names))


def _places(path: Path, header: Sequence[str], names: Sequence[str]) -> list[int]:
    """Where each of the columns stands in the first row of a table."""
    for mark, called in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and mark in header[0]:
            raise UsageError(f"{path} is divided by {called}: commas between columns and points in numbers are due")
    for name in names:
        if header.count(name) != 1:
            said = "twice or more" if name in header else "not"
            raise UsageError(f"{path}: the column {name!r} is {said} there; columns: {', '.join(header[:30])}")
    return [header.index(name) for name in names]


# --- Columns of a table that others give exactly: copies and linear combinations, which no analysis can tell apart.

#: what is left of a column over its standard deviation, below which others give it: files keep seven figures and more
_LEFT = 1e-6
#: rows beyond the columns that take part, from which on a combination is no accident of few rows
_SPARE = 5
#: columns that are named
_NAMED = 6


@dataclass(frozen=True, kw_only=True)
class Combination:
    """Column `column` = `constant` + the sum of `factors` times the columns `of`."""

    column: int
    of: tuple[int, ...]
    factors: tuple[float, ...]
    constant: float

    def text(self, names: Sequence[str]) -> str:
        """In words, with the names of all columns."""
        name = names[self.column]
        if len(self.of) == 1:
            return f"{name} tells the same as {names[self.of[0]]}: leave one of them out"
        signed = [(self.constant, "")] if self.constant else []
        signed += [(factor, names[j]) for j, factor in zip(self.of, self.factors, strict=True)]
        formula = " ".join(_term(*term) for term in signed[:_NAMED]).removeprefix("+ ")
        more = f" and {len(signed) - _NAMED} terms more" if len(signed) > _NAMED else ""
        return (
            f"{name} is an exact linear combination of other columns, {name} = {formula}{more}: leave one of them out, "
            "since nothing tells what each of them does"
        )


def _term(factor: float, name: str) -> str:
    """A signed term of a sum, without a factor of one."""
    size = f"{abs(factor):.4g}"
    parts = ["-" if factor < 0.0 else "+", *([] if size == "1" and name else [size]), name]
    return " ".join(part for part in parts if part)


def combinations(x: Array) -> list[Combination]:
    """Columns of x (n, d) that those before them give exactly; columns that do not vary are left out.

    >>> x = np.random.default_rng(1).normal(size=(50, 2))
    >>> found = combinations(np.column_stack([x, x[:, 0] + 2.0 * x[:, 1]]))
    >>> found[0].column, found[0].of, [round(factor, 6) for factor in found[0].factors]
    (2, (0, 1), [1.0, 2.0])
    """
    spread, centre = x.std(axis=0), x.mean(axis=0)
    varying = [k for k in range(x.shape[1]) if np.isfinite(spread[k]) and spread[k] > 1e-14 * abs(centre[k])]
    # lengths and angles of the columns are those of the triangle that they are a rotation of
    triangle = np.asarray(np.linalg.qr((x[:, varying] - centre[varying]) / spread[varying], mode="r"))
    columns = dict(zip(varying, triangle.T, strict=True))
    found = []
    kept: list[int] = []
    for k, column in columns.items():
        others = np.array([columns[j] for j in kept]).reshape(len(kept), len(column)).T
        weights = np.linalg.lstsq(others, column, rcond=None)[0] if kept else np.zeros(0)
        if float(np.linalg.norm(column - others @ weights)) > _LEFT * float(np.linalg.norm(column)):
            kept.append(k)
        elif len(x) >= len(kept) + 1 + _SPARE:
            of = {j: float(w * spread[k] / spread[j]) for j, w in zip(kept, weights, strict=True) if abs(w) > 1e-5}
            constant = float(centre[k] - sum(factor * centre[j] for j, factor in of.items()))
            constant = constant if abs(constant) > 1e-5 * spread[k] else 0.0
            found.append(Combination(column=k, of=tuple(of), factors=tuple(of.values()), constant=constant))
    return found


# --- the table -----------------------------------------------------------------------------------------------------

SCHEMA_VERSION: Final = 2
#: rows that an expansion is fitted to: beyond, it gains nothing
_MOST_FITTED: Final = 2000
#: a law that so few samples of its own would lie as far from is doubted
_DOUBT: Final = 0.01
_LAWS: Final = 400
#: so few different values are levels
_LEVELS: Final = 10
_QUANTILES: Final = (0.05, 0.5, 0.95)
#: a rank correlation from which on two inputs tell the same
_SAME: Final = 0.999
#: standard errors by which ranks and expansion must differ to be told
_APART: Final = 3.5


@dataclass(frozen=True, kw_only=True, eq=False)
class _Laws:
    """The laws of the inputs that vary, by their columns, with what the runs leave open; why there are none."""

    columns: tuple[int, ...]
    inputs: Joint | None
    others: tuple[tuple[Law, ...], ...]
    reason: str = ""


def known_laws(path: Path, names: Sequence[str]) -> Joint:
    """Laws and dependence of the inputs that the runs were drawn from, out of a study.

    Raises StudyError for a file that is no study, UsageError for an input that has no law there.
    """
    from uqsphere.study import load_study

    study = load_study(path)
    missing = [name for name in names if name not in study.random]
    if missing:
        raise UsageError(f"{path} has no law of {missing[0]!r}; random there: {', '.join(study.random) or 'nothing'}")
    return study.inputs().only(tuple(names))


def analyse_runs(data: Data, *, known: Joint | None = None, seed: int = 0) -> tuple[Document, dict[str, Surrogate]]:
    """Marginal laws with their fit and what it leaves open, rank correlations, distributions of the outputs,
    first-order indices by ranks, and what an expansion tells, ready for JSON; and the surrogates that may be used, by
    output.

    `known`: laws that the runs were drawn from, in the order of the inputs; they are fitted to the runs otherwise.
    """
    from threadpoolctl import threadpool_limits

    # one thread of linear algebra: the same bytes on every machine, and no threads that wait for each other
    with threadpool_limits(limits=1, user_api="blas"):
        marginals, laws = _fitted(data, seed) if known is None else _given(data, known)
        ties, dependence = _dependence(data, fitted=known is None)
        if known is None:
            laws = _tied(data, laws, ties)
        combined = [one.text(data.inputs) for one in combinations(data.x)]
        if combined:
            laws = replace(laws, inputs=None, others=(), reason=combined[0])
        answers = {name: _answered(data, k, laws, ties, seed) for k, name in enumerate(data.outputs)}
    document = {
        "schema_version": SCHEMA_VERSION,
        "rows": len(data.x),
        "laws": "fitted" if known is None else "known",
        "inputs": marginals,
        "dependence": dependence,
        "combinations": combined,
        "outputs": {name: output for name, (output, _, _) in answers.items()},
        "sensitivity": {name: drivers for name, (_, drivers, _) in answers.items()},
    }
    return document, {name: surrogate for name, (_, _, surrogate) in answers.items() if surrogate is not None}


def _dependence(data: Data, *, fitted: bool) -> tuple[tuple[TiedPair, ...], list[Document]]:
    """Pairs of inputs that depend on each other with their copula, and what is said of all pairs that vary."""
    varying = [k for k in range(len(data.inputs)) if np.ptp(data.x[:, k]) > 0.0]
    pairs = rank_correlations(data.x[:, varying]) if len(varying) > 1 else []
    pairs = [(varying[i], varying[j], e) for i, j, e in pairs]
    clear = {(i, j) for i, j, _ in tied(pairs)}
    ties = ties_of(data.x, {(i, j): float(e.value or 0.0) for i, j, e in pairs if (i, j) in clear})
    copulas = {tie.columns: tie.copula for tie in ties}
    entries = []
    for i, j, e in pairs:
        entry: Document = {
            "of": [data.inputs[i], data.inputs[j]],
            "spearman": e.as_dict(),
            "dependent": (i, j) in clear,
        }
        entries.append({**entry, "copula": copulas.get((i, j))} if fitted else entry)
    return ties, entries


# --- laws -----------------------------------------------------------------------------------------------------


def _fitted(data: Data, seed: int) -> tuple[Document, _Laws]:
    from uqsphere.uq import random_generator

    marginals: Document = {}
    columns, laws, others, unknown = [], [], [], []
    for k, name in enumerate(data.inputs):
        values = data.x[:, k]
        generator = random_generator(seed=seed, task=f"analyse {name}")
        marginals[name], law, open_ = _marginal(values, generator)
        if law is None:
            if np.ptp(values) > 0.0:
                unknown.append(name)
            continue
        columns.append(k)
        laws.append(law)
        others.append((law,) * _LAWS if law.family.observed else tuple(open_))
    names = tuple(data.inputs[k] for k in columns)
    reason = f"no law was found for {', '.join(unknown)}" if unknown else "" if names else "no input varies"
    inputs = None if reason else Joint(names=names, laws=tuple(laws))
    return marginals, _Laws(columns=tuple(columns), inputs=inputs, others=tuple(others), reason=reason)


def _marginal(values: Array, generator: np.random.Generator) -> tuple[Document, Law | None, list[Law]]:
    """One input: every law that was tried, which is taken, and what the observations leave open of it."""
    from uqsphere.uq.fitting import fit_marginal, plausible, plausible_laws, possible_laws

    try:
        fits = fit_marginal(values)
    except ValueError as error:
        same = float(values[0]) if np.ptp(values) == 0.0 else None
        return {"chosen": None, "reason": str(error), "fits": [], "fixed": same}, None, []
    best, law, reason = fits[0], fits[0].law, None
    weights = {fit.law.family.name: weight for fit, weight in plausible(fits)}
    if best.p_value < _DOUBT:
        law, weights = _kernels(values[:5000]), {}
        reason = f"no family fits: even the best, {best.law.family.name}, has a p-value of {best.p_value:.2g}"
        if (levels := np.unique(values).size) <= _LEVELS:
            reason = f"it has {levels} values only, and the kernel density fills the gaps between them"
        others = possible_laws(law, 100, generator) if values.size <= 500 else []
    else:
        others = plausible_laws(fits, _LAWS, generator)
    tried = [(f.law, f.criterion - best.criterion, f.distance, f.p_value) for f in fits]
    entry = _entry(law, tried, weights, reason, _left_open(law, others))
    return {**entry, "chosen": "kde" if reason else law.family.name}, law, others


def _entry(
    law: Law,
    tried: Sequence[tuple[Law, float, float, float]],
    weights: Mapping[str, float],
    reason: str | None,
    opened: Iterable[list[float] | None] = (None, None),
) -> Document:
    """The law of an input, those that were tried (law, criterion, distance, p-value), and what is left open of it."""
    bounds = {"lower": law.lower, "upper": law.upper} if law.family.bounded else {}
    mean, sd = opened
    return {
        "chosen": law.family.name,
        "parameters": {**law.parameters, **bounds},
        "fits": [{"dist": one.family.name, "criterion": criterion, "distance": distance, "p_value": p}
                 for one, criterion, distance, p in tried],
        "weights": dict(weights),
        "reason": reason,
        "mean": law.mean(),
        "sd": law.sd(),
        "mean_left_open": mean,
        "sd_left_open": sd,
    }  # fmt: skip


def _left_open(law: Law, others: Sequence[Law]) -> Iterator[list[float] | None]:
    """Between which mean and standard deviation lie under the laws that the observations leave open."""
    for what in ("mean", "sd"):
        if not law.family.observed:
            found = np.array([getattr(other, what)() for other in others])
        elif what == "mean":  # of a sum of kernels both are closed forms
            found = np.array([np.mean(other.data) for other in others])
        else:
            found = np.array([math.hypot(float(np.std(other.data)), other.parameters["bandwidth"]) for other in others])
        found = found[np.isfinite(found)]
        yield [float(end) for end in np.quantile(found, [0.025, 0.975])] if found.size else None


def _kernels(values: Array) -> Law:
    """A kernel density with the mean and the variance of the observations.

    Kernels of width h would widen it by h², a tenth of the variance where 100 observations lie in two humps; the
    observations move inward by that much (B. W. Silverman, G. A. Young, Biometrika 74, 1987, 469).
    """
    from uqsphere.uq.fitting import fitted_law

    law = fitted_law(values.tolist())
    centre, spread = float(values.mean()), float(values.std(ddof=1))
    inward = spread / math.hypot(spread, law.parameters["bandwidth"])
    return fitted_law((centre + inward * (values - centre)).tolist())


def _given(data: Data, known: Joint) -> tuple[Document, _Laws]:
    """Laws that the runs were drawn from, and whether the runs look like it."""
    from uqsphere.uq.fitting import goodness

    marginals: Document = {}
    for k, (name, law) in enumerate(zip(known.names, known.laws, strict=True)):
        distance, p_value = goodness(law, data.x[:, k])
        doubt = f"its runs do not look drawn from its law (p-value {p_value:.2g})" if p_value < _DOUBT else None
        marginals[name] = _entry(law, [(law, 0.0, distance, p_value)], {}, doubt)
    return marginals, _Laws(columns=tuple(range(len(known.names))), inputs=known, others=())


def _tied(data: Data, laws: _Laws, ties: Sequence[TiedPair]) -> _Laws:
    """The laws with copulas of the pairs that depend on each other, or why there are none."""
    if laws.inputs is None or not ties:
        return laws
    same = next((tie.columns for tie in ties if abs(tie.spearman) > _SAME), None)
    try:
        if same is not None:
            one, other = (data.inputs[k] for k in same)
            raise LawError(f"{other} tells the same as {one}: leave one of them out")
        return replace(laws, inputs=with_ties(laws.inputs.names, laws.inputs.laws, ties, data.inputs))
    except LawError as error:
        said = str(error) if same is not None else f"the dependences of the inputs cannot be followed: {error}"
        return replace(laws, inputs=None, others=(), reason=said)


# --- outputs ---------------------------------------------------------------------------------------------------


def _answered(
    data: Data, column: int, laws: _Laws, ties: Sequence[TiedPair], seed: int
) -> tuple[Document, Document, Surrogate | None]:
    """What is known of one output: its distribution, what drives it, and its surrogate."""
    from uqsphere.uq import random_generator
    from uqsphere.uq.beyond_variance import rank_indices

    name = data.outputs[column]
    y = data.y[:, column]
    # a power of two loses no figures, and squares of what is divided by it stay finite
    largest = float(np.abs(y).max())
    unit = 2.0 ** min(max(math.frexp(largest)[1], -1000), 1000) if largest > 0.0 else 1.0
    generator = random_generator(seed=seed, task=f"analyse ranks {name}")
    n, quantiles = y.size, {}
    for p in _QUANTILES:
        reason = f"{n} runs are too few for an interval of the {p:g} quantile"
        quantiles[f"{p:g}"] = quantile_interval(y / unit, p) or absent(reason, "order statistics", n)
    ranks = dict(zip(data.inputs, rank_indices(data.x, y / unit, generator), strict=True))
    found, chaos, surrogate = _expansion(data, y / unit, laws, ties, (seed, name))
    told = None
    if found is not None:
        told = {
            what: {
                "whole": _scaled(entry["whole"], unit),
                "surrogate": _scaled(entry["surrogate"], unit),
                "left_open": entry["left_open"] * unit,
            }
            for what, entry in found.pop("statistics").items()
        }
        chaos |= found
    scaled: Document = {
        "mean": _scaled(mean_alone(y / unit).as_dict(), unit),
        "sd": _scaled(sd_alone(y / unit).as_dict(), unit),
        "quantiles": {p: _scaled(e.as_dict(), unit) for p, e in quantiles.items()},
        "expansion": told,
        "notes": _looks(y / unit, unit),
    }
    apart = _apart(ranks, chaos, scaled)
    drivers = {"ranks": {n: e.as_dict() for n, e in ranks.items()}, "chaos": chaos, "disagree": apart}
    return scaled, drivers, None if surrogate is None else replace(surrogate, unit=unit)


def _looks(values: Array, unit: float) -> list[str]:
    """What is to be said of an output before its numbers are believed."""
    n = values.size
    told: list[str] = []
    if np.ptp(values) == 0.0:
        return told
    for end, called in ((values.max(), "largest"), (values.min(), "smallest")):
        count = int((values == end).sum())
        if count >= max(3.0, 0.02 * n) and np.unique(values).size > _LEVELS:
            told.append(
                f"{count} of {n} runs have the {called} value, {end * unit:.4g}: if a record ends there, mean and "
                "standard deviation are those of what was recorded, and quantiles there are not known"
            )
    off = ((values - values.mean()) / np.abs(values).max()) ** 2
    share = float(off.max() / off.sum())
    if n >= 20 and share > 0.3:
        told.append(f"one run makes {share:.0%} of the variance: tails are heavy, and mean, standard deviation and "
                    "shares of the variance are not settled")  # fmt: skip
    return told


def _scaled(entry: Document, unit: float) -> Document:
    """An estimate in its own unit; one whose ends leave floating point is absent."""
    numbers = {key: entry[key] for key in ("value", "low", "high", "std_error") if entry[key] is not None}
    scaled = {key: float(value) * unit for key, value in numbers.items()}
    if all(math.isfinite(value) for value in scaled.values()):
        return {**entry, **scaled}
    return absent(
        "beyond what floating point can hold: change the unit", entry["method"], entry["evaluations"]
    ).as_dict()


# --- the expansion ---------------------------------------------------------------------------------------------


def _expansion(
    data: Data, y: Array, laws: _Laws, ties: Sequence[TiedPair], key: tuple[int, str]
) -> tuple[Document | None, Document, Surrogate | None]:
    """What an expansion tells, where it passes its check, what there is to say about it, and the expansion."""
    from uqsphere.uq import random_generator

    seed, name = key
    generator = random_generator(seed=seed, task=f"analyse expansion {name}")
    rows = generator.permutation(len(y))[:_MOST_FITTED]
    scores: Array | None = None
    response, reason = None, _hopeless(y, laws, len(rows))
    if laws.inputs is not None and not reason:
        x = data.x[rows][:, list(laws.columns)]
        scores = law_scores(laws.inputs.laws, x)
        try:
            response = response_from(scores, y[rows], germs_of(laws.inputs.laws))
            reason = "" if response.usable else response.reason
        except ValueError as error:
            reason = str(error)
    if laws.inputs is None or response is None or scores is None or reason:
        return None, {"usable": False, "error": response and response.error, "reason": reason}, None
    opened = left_open(laws.inputs, laws.others, ties, data.inputs, scores, len(data.x), generator)
    answers = given_answers(response, laws.inputs, opened, quantiles=_QUANTILES, seed=seed, task=name)
    found = {
        order: {
            label: {"whole": a.whole.as_dict(), "surrogate": a.surrogate.as_dict(), "left_open": a.left_open}
            for label, a in rows_.items()
        }
        for order, rows_ in answers.items()
    }
    notes = _notes(data, laws.inputs, ties, scores) if laws.inputs.dependent else []
    kind = "dependent" if laws.inputs.dependent else "sobol"
    surrogate = surrogate_from(response, x, scores, laws.inputs, output=name)
    about = {"usable": True, "error": response.error, "reason": response.reason, "notes": notes, "kind": kind}
    return found, about, surrogate


def _hopeless(y: Array, laws: _Laws, rows: int) -> str:
    """Why no expansion is fitted; empty where it is tried."""
    if laws.inputs is None:
        return laws.reason
    if np.ptp(y) <= 1e-14 * np.abs(y).max(initial=0.0):
        return "the output does not vary"
    # over kernel densities, fitted to the same runs, intervals were counted to hold too rarely
    kernels = [n for n, law in zip(laws.inputs.names, laws.inputs.laws, strict=True) if law.family.observed]
    if laws.others and kernels:
        return f"no family fits {kernels[0]}: what its kernel density leaves open is not known well enough"
    needed = least_rows(len(laws.columns))
    if rows < needed:
        return f"{rows} runs are too few for {len(laws.columns)} inputs: {needed} are needed"
    return ""


def _notes(data: Data, inputs: Joint, ties: Sequence[TiedPair], scores: Array) -> list[str]:
    """What is to be said of shares where inputs depend on each other."""
    among = sorted({data.inputs[i] for tie in ties for i in tie.columns}) or list(inputs.names)
    return [
        f"{', '.join(among)} depend on each other: Sobol' indices would not share out the variance; Shapley effects "
        "do, and first and total are Kucherenko's, whose total may lie below the first",
        *(f"{one} and {other} depend on each other otherwise than the {kind} copula that is taken here: the "
          "shares are in doubt" for one, other, kind in odd_pairs(inputs, scores)),
    ]  # fmt: skip


def _apart(ranks: Mapping[str, Estimate], chaos: Document, output: Document) -> list[str]:
    """Where the expansion and what needs none differ by more than chance."""
    pairs = [
        (f"first-order index of {name}", ".2f", "by ranks", estimate.as_dict(), chaos["first"][name]["whole"])
        for name, estimate in ranks.items()
        if name in chaos.get("first", {})
    ]
    if output["expansion"] is not None:
        pairs += [(what, ".4g", "by the runs alone", output[what], output["expansion"][what]["whole"])
                  for what in ("mean", "sd")]  # fmt: skip
    told = []
    for what, form, way, alone, other in pairs:
        if None in (alone["value"], other["value"], alone["std_error"]):
            continue
        if abs(alone["value"] - other["value"]) > _APART * math.hypot(
            *(cast("float", one["std_error"]) for one in (alone, other))
        ):
            told.append(f"{what}: {alone['value']:{form}} {way}, {other['value']:{form}} by expansion")
    return told


def quantile_interval(values: Array, p: float) -> Estimate | None:
    """Quantile of independent observations (n,) between two of them: the shortest pair whose binomial coverage is
    95 %; None where there are too few."""
    from scipy.stats import binom

    ordered = np.sort(values)
    n = ordered.size
    low, high = int(binom.ppf(0.025, n, p)), int(binom.ppf(0.975, n, p))
    # P(x_(low) <= quantile < x_(high + 1)) = F(high) - F(low - 1), counted from 1
    if low < 1 or high + 1 > n:
        return None
    value = float(np.quantile(ordered, p, method="hazen"))
    ends = float(ordered[low - 1]), float(ordered[high])
    return Estimate(
        value=value, low=min(ends[0], value), high=max(ends[1], value), std_error=(ends[1] - ends[0]) / 3.92,
        method="order statistics", evaluations=n,
    )  # fmt: skip
