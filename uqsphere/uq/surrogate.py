"""A surrogate as an object: what rows told of one output, with an interval at every point and a domain of validity.

The value is the mean of fits that are made without one fold of the n rows each.  With r_i what row i differs from the
fit that has not seen it, and s(x) the standard error of a new answer by least squares, in units of the noise,

    |y - value| <= q s(x),      s(x)^2 = (dy/dz)^2 (1 + p(x)' (P'P)^-1 p(x))

with q the ceil(level (n + 1))-th of the |r_i|/s_i (J. Lei et al., J. Am. Stat. Assoc. 113, 2018, 1094: residuals of
rows left out, scaled).  It holds for points drawn as the rows were.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.errors import AccessError, UsageError
from uqsphere.uq.estimate import Estimate
from uqsphere.uq.expansion import Chaos, Piece, fit_chaos, germ_points
from uqsphere.uq.expansion.expansion import Border, Transform
from uqsphere.uq.expansion.germs import GERMS, Germ, GermLike, germs_of, rows_of
from uqsphere.uq.families import LawError, family_stored
from uqsphere.uq.joint import Joint
from uqsphere.uq.law import Law
from uqsphere.uq.response import Response, cross_fit, index_shares

#: points that are answered at a time: rows times fits stay in memory
_BLOCK: Final = 1024
#: normal score beyond which a law's values are those at it, on either side: 1e-15 lies beyond
FARTHEST: Final = 8.0
#: bytes of a surrogate that is read
_LARGEST: Final = 1 << 28

#: n points: a column (n,) by every input's name, a table of pandas, or an array (n, d) in the order of the inputs
Rows: TypeAlias = Any


class Prediction(NamedTuple):
    """What a surrogate says of n points, (n,) each: the value, and between which the model's answer lies."""

    value: Array
    low: Array
    high: Array


def law_scores(laws: Sequence[Law], x: Array) -> Array:
    """Normal scores (n, d) of values (n, d) under their laws, within 8 of the median."""
    return np.column_stack([scores_of(law.cdf(x[:, k]), law.sf(x[:, k])) for k, law in enumerate(laws)])


def scores_of(below: Array, above: Array) -> Array:
    """Normal scores of probabilities below and above, through the smaller of the two."""
    from scipy.special import ndtri

    with np.errstate(divide="ignore"):
        return np.clip(np.where(below < 0.5, ndtri(below), -ndtri(above)), -FARTHEST, FARTHEST)


@dataclass(frozen=True, kw_only=True, eq=False)
class Surrogate:
    """A surrogate of one output.

    Attributes
    ----------
    output, names, laws : what it answers, of which inputs (d), and their laws.
    response : the fits and their residuals; `response.error` is the share of the variance that it leaves.
    lowest, highest : (d,) ends of the rows in each input, in the inputs' own units.
    spread : (d, d) inverse covariance of the rows' normal scores, for inputs that depend on each other; else None.
    reach : the largest squared distance of a row by `spread`.
    unit : what the response counts the output in.
    """

    output: str
    names: tuple[str, ...]
    laws: tuple[Law, ...]
    response: Response
    lowest: Array
    highest: Array
    spread: Array | None = None
    reach: float = math.inf
    unit: float = 1.0

    def __repr__(self) -> str:
        one = self.response
        return (f"<Surrogate of {self.output!r} in {', '.join(self.names)}: {one.terms} terms from {one.count} rows, "
                f"leaves {one.error:.2g} of the variance>")  # fmt: skip

    def columns(self, rows: Rows) -> Array:
        """Points (n, d) of rows, which must have every input, finite."""
        named = hasattr(rows, "columns") or isinstance(rows, Mapping)
        if missing := [name for name in self.names if named and name not in rows]:
            raise UsageError(f"{missing[0]} is missing; the surrogate takes {', '.join(self.names)}")
        try:
            if named:
                parts = [np.atleast_1d(np.asarray(rows[name], dtype=float)) for name in self.names]
                x = np.stack(np.broadcast_arrays(*parts), axis=-1)
            else:
                x = np.asarray(rows, dtype=float)
        except (TypeError, ValueError) as error:
            raise UsageError(f"the rows are no columns of numbers, of one length: {error}") from error
        if x.ndim != 2 or x.shape[1] != len(self.names):
            raise UsageError(f"rows of shape (n, {len(self.names)}) are due, found {x.shape}")
        if not np.isfinite(x).all():
            raise UsageError("the rows hold what is no finite number")
        return x

    def germs(self, rows: Rows) -> Array:
        """Germs (n, d) at rows, which the expansions are polynomials of."""
        germs = self.response.germs
        points = germ_points(law_scores(self.laws, self.columns(rows)), germs)
        values = [one.values(x) if isinstance(one, Germ) else x for one, x in zip(germs, points.T, strict=True)]
        return np.column_stack(values)

    def predict(self, rows: Rows, level: float = 0.95) -> Prediction:
        """What the model would answer to rows, with the interval that holds the answer at this level.

        Parameters
        ----------
        rows : mapping of input to (n,) column, table of pandas, or array (n, d), in the inputs' own units
        level : share of points, drawn as the rows were, whose answer lies in its interval

        Returns
        -------
        Prediction
            value, low and high, (n,) each; infinite ends where the surrogate has too few rows to tell them.

        Raises
        ------
        UsageError
            For points outside the domain that the rows cover, with the first such row and its input (`inside` tells
            which rows may be asked), and for rows without an input.
        """
        if not 0.0 < level < 1.0:
            raise UsageError(f"level must lie between 0 and 1, found {level}")
        x = self.columns(rows)
        self._refuse_outside(x)
        points = germ_points(law_scores(self.laws, x), self.response.germs)
        parts = [self._between(points[k : k + _BLOCK], level) for k in range(0, max(len(points), 1), _BLOCK)]
        return Prediction(*(self.unit * np.concatenate(column) for column in zip(*parts, strict=True)))

    def _between(self, points: Array, level: float) -> tuple[Array, Array, Array]:
        one, n = self.response, self.response.count
        value = one.at(points)
        rank = math.ceil(level * (n + 1))
        if rank > n:
            nothing = np.full(len(points), math.inf)
            return value, -nothing, nothing
        local = np.mean([_standard_error(fit, one.points[one.folds != k], points) for k, fit in enumerate(one.fits)],
                        axis=0)  # fmt: skip
        half = self._scores[rank - 1] * local
        return value, value - half, value + half

    @cached_property
    def _scores(self) -> Array:
        """Residuals (n,) over their standard errors, in order."""
        one = self.response
        local = np.empty(one.count)
        for k, fit in enumerate(one.fits):
            own = one.folds == k
            local[own] = _standard_error(fit, one.points[~own], one.points[own])
        return np.sort(np.abs(one.residuals) / local)

    def inside(self, rows: Rows) -> npt.NDArray[np.bool_]:
        """Which rows (n,) lie in the domain that the surrogate's own rows cover: those that `predict` takes."""
        x = self.columns(rows)
        return np.asarray(((x >= self.lowest) & (x <= self.highest)).all(axis=1) & ~self._far(x))

    def _far(self, x: Array) -> npt.NDArray[np.bool_]:
        """Which points (n, d) lie farther than any row from what ties the inputs."""
        if self.spread is None:
            return np.zeros(len(x), dtype=bool)
        scores = law_scores(self.laws, x)
        return np.asarray(np.einsum("ni,ij,nj->n", scores, self.spread, scores) > self.reach)

    def _refuse_outside(self, x: Array) -> None:
        off = np.flatnonzero(~self.inside(x))
        if not off.size:
            return
        first = x[off[0]]
        where = f"row {off[0]} of {len(x)}, from 0: " if len(x) > 1 else ""
        others = f"; {off.size} rows of {len(x)} lie outside, predict(rows[surrogate.inside(rows)]) answers the others"
        others = others if len(x) > 1 else ""
        for name, value, low, high in zip(self.names, first, self.lowest, self.highest, strict=True):
            if not low <= value <= high:
                raise UsageError(f"{where}{name} = {value:.6g} lies outside of {low:.6g} to {high:.6g}, which the rows "
                                 f"cover: more rows reach farther, and so does a wider law{others}")  # fmt: skip
        point = ", ".join(f"{n} = {v:.6g}" for n, v in zip(self.names, first, strict=True))
        raise UsageError(f"{where}{point}: no row lies so far from what ties the inputs, though each by itself does"
                         f"{others}")  # fmt: skip

    def indices(self) -> dict[str, dict[str, Estimate]]:
        """First and total Sobol' indices of the model with what the surrogate lacks: `{"first": {input: ...}, ...}`.

        Raises UsageError where the inputs depend on each other (`uqsphere.analysis.shapley_effects` serves those).
        """
        if self.spread is not None:
            raise UsageError("the inputs depend on each other: Sobol' indices would not share out the variance")
        found = index_shares(self.response)
        return {order: dict(zip(self.names, row, strict=True)) for order, row in found.items()}

    def to_chaospy(self) -> Any:
        """The expansion as a polynomial of chaospy in the germs q0, q1, ...: `polynomial(*surrogate.germs(rows).T)`.

        Its values are those of `predict`, but for rounding; `uqsphere.uq.interop.expansion_to_chaospy`.
        """
        from uqsphere.uq.interop import expansion_to_chaospy

        return self.unit * expansion_to_chaospy(self.response)

    def save(self, path: str | Path) -> Path:
        """Write the surrogate as plain arrays and one text, an .npz that needs no pickle; the path."""
        content = self.content()
        try:
            Path(path).write_bytes(content)
        except OSError as error:
            raise AccessError(f"{path} cannot be written: {error}") from error
        return Path(path)

    def content(self) -> bytes:
        """What `save` writes; raises UsageError over laws that are known by their functions alone."""
        one, file = self.response, io.BytesIO()
        arrays = {"points": one.points, "outputs": one.outputs, "folds": one.folds, "levels": one.levels,
                  "residuals": one.residuals, "lowest": self.lowest, "highest": self.highest}  # fmt: skip
        if self.spread is not None:
            arrays["spread"] = self.spread
        fits = []
        for k, fit in enumerate(one.fits):
            for p, piece in enumerate(fit.pieces):
                arrays[f"coefficients_{k}_{p}"] = piece.coefficients
                arrays[f"indices_{k}_{p}"] = piece.multi_indices
            fits.append(_fit_document(fit))
        laws = [_law_document(law) for law in self.laws]
        told = {"version": 1, "output": self.output, "names": self.names, "laws": laws, "error": one.error,
                "reach": self.reach, "unit": self.unit, "fits": fits}  # fmt: skip
        np.savez(file, document=np.array(json.dumps(told)), **arrays)  # type: ignore[arg-type]
        return file.getvalue()


def load_surrogate(path: str | Path) -> Surrogate:
    """A surrogate from the file that `Surrogate.save` wrote: the same numbers, bit by bit.

    Raises
    ------
    AccessError
        Where the file cannot be read.
    UsageError
        For a file that holds no surrogate.
    """
    try:
        if Path(path).stat().st_size > _LARGEST:
            raise UsageError(f"{path} is larger than any surrogate")
        with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except OSError as error:
        raise AccessError(f"{path} cannot be read: {error}") from error
    except (TypeError, ValueError, BadZipFile) as error:
        raise UsageError(f"{path} holds no surrogate") from error
    try:
        told = json.loads(str(arrays["document"]))
        laws = tuple(_law_of(law) for law in told["laws"])
        response = Response(
            fits=tuple(_fit_of(fit, laws, arrays, k) for k, fit in enumerate(told["fits"])),
            folds=arrays["folds"], points=arrays["points"], outputs=arrays["outputs"], levels=arrays["levels"],
            residuals=arrays["residuals"], error=float(told["error"]),
        )  # fmt: skip
        return Surrogate(output=told["output"], names=tuple(told["names"]), laws=laws, response=response,
                         lowest=arrays["lowest"], highest=arrays["highest"], spread=arrays.get("spread"),
                         reach=float(told["reach"]), unit=float(told["unit"]))  # fmt: skip
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(f"{path} holds no surrogate: {type(error).__name__} {error}") from error


def _law_document(law: Law) -> dict[str, object]:
    if family_stored(law.family.name) is None:
        raise UsageError(f"a surrogate over a law of {law.family.name} that is wrapped cannot be saved: give the law "
                         "of scipy.stats")  # fmt: skip
    return {**{key: value for key, value in vars(law).items() if key in _LAW}, "family": law.family.name}


_LAW: Final = ("parameters", "lower", "upper", "data", "censored", "draws")


def _law_of(told: Mapping[str, Any]) -> Law:
    family = family_stored(told["family"])
    if family is None:
        raise ValueError(f"there is no distribution {told['family']!r}")
    data, censored = (tuple(told[key]) for key in ("data", "censored"))
    return Law(family=family, parameters=told["parameters"], lower=told["lower"], upper=told["upper"], data=data,
               censored=censored, draws=tuple(map(tuple, told["draws"])))  # fmt: skip


def _fit_document(fit: Chaos) -> dict[str, object]:
    border = None if fit.border is None else dict(vars(fit.border))
    if border is not None and border["weights"] is not None:
        border["weights"] = border["weights"].tolist()
    return {
        "germs": [germ if isinstance(germ, str) else "own" for germ in fit.germs],
        "transforms": [None if piece.transform is None else asdict(piece.transform) for piece in fit.pieces],
        "border": border,
        "error": fit.cross_validation_error,
        "samples": fit.samples,
        "solver": fit.solver,
    }


def _fit_of(told: Mapping[str, Any], laws: Sequence[Law], arrays: Mapping[str, Array], k: int) -> Chaos:
    germs: list[GermLike] = [name if name in GERMS else germs_of((law,))[0]
                             for name, law in zip(told["germs"], laws, strict=True)]  # fmt: skip
    pieces = tuple(
        Piece(coefficients=arrays[f"coefficients_{k}_{p}"], multi_indices=arrays[f"indices_{k}_{p}"].astype(np.int64),
              transform=None if transform is None else Transform(**transform))
        for p, transform in enumerate(told["transforms"])
    )  # fmt: skip
    border = None if told["border"] is None else Border(**told["border"])
    if border is not None and border.weights is not None:
        border = replace(border, weights=np.array(border.weights))
    return Chaos(pieces=pieces, border=border, germs=tuple(germs), cross_validation_error=float(told["error"]),
                 samples=int(told["samples"]), solver=str(told["solver"]))  # fmt: skip


def _standard_error(fit: Chaos, rows: Array, points: Array) -> Array:
    """Standard error (n,) of a new answer at germ points (n, d), over the noise, of a fit to rows (N, d)."""
    found, here, there = np.ones(len(points)), [], []
    for piece in fit.pieces:
        here.append(rows_of(fit.germs, rows, piece.multi_indices))
        there.append(rows_of(fit.germs, points, piece.multi_indices))
    sides = [np.zeros(len(x), dtype=bool) for x in (rows, points)]
    if fit.border is not None:
        for side, where, products in zip(sides, (rows, points), (here, there), strict=True):
            values = [piece.back(piece.coefficients @ own) for piece, own in zip(fit.pieces, products, strict=True)]
            side[:] = fit.border.side(where, values)
    for k, piece in enumerate(fit.pieces):
        known, asked = here[k][:, sides[0] == bool(k)], there[k][:, sides[1] == bool(k)]
        # as many rows as terms, or fewer, tell least squares nothing of the noise: a millionth keeps it solvable
        matrix = known @ known.T + 1e-6 * max(known.shape[1], 1) * np.eye(len(known))
        error = np.sqrt(1.0 + np.einsum("pn,pn->n", asked, np.linalg.solve(matrix, asked)))
        if piece.transform is not None:
            slope = np.abs(piece.transform.slope(piece.coefficients @ asked))
            # where the bounds of the transform hold the value, the mean slope
            error *= np.where(slope > 0.0, slope, float(np.sqrt(np.mean(slope**2))) if slope.any() else 1.0)
        found[sides[1] == bool(k)] = error
    return found


# --- fitting one ------------------------------------------------------------------------------------------------


def least_rows(inputs: int) -> int:
    """Rows below which no surrogate is fitted."""
    return max(16, 4 * (inputs + 1))


def fit_surrogate(x: Array, y: Array, inputs: Joint, *, output: str = "y", plain: bool = False) -> Surrogate:
    """A surrogate of outputs (n,) at rows (n, d) drawn from the laws of the inputs, in any order that tells nothing.

    `plain`: expand the output itself, in one piece.  Raises UsageError for rows that are too few or lie where their
    laws have nothing; whether it may be used, `response.usable` says.
    """
    d, n = len(inputs.names), len(y)
    if x.shape != (n, d) or y.ndim != 1:
        raise UsageError(f"rows (n, {d}) and outputs (n,) are due, found {x.shape} and {y.shape}")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise UsageError("rows and outputs must be finite: leave rows without an answer out")
    if n < least_rows(d):
        raise UsageError(f"{n} rows are too few for {d} inputs: {least_rows(d)} are needed")
    for k, (name, law) in enumerate(zip(inputs.names, inputs.laws, strict=True)):
        outside = (x[:, k] < law.lower) | (x[:, k] > law.upper)
        if outside.any():
            raise UsageError(f"{name} = {x[outside][0, k]:.6g} lies where its law has nothing")
    scores = law_scores(inputs.laws, x)
    try:
        response = response_from(scores, y, germs_of(inputs.laws), plain=plain)
    except (ValueError, LawError) as error:
        raise UsageError(f"no surrogate of {output}: {error}") from error
    return surrogate_from(response, x, scores, inputs, output=output)


def surrogate_from(
    response: Response, x: Array, scores: Array, inputs: Joint, *, output: str, unit: float = 1.0
) -> Surrogate:
    """A response to rows x (n, d) with these normal scores (n, d) as a surrogate; `unit` is what it counts in."""
    made = Surrogate(output=output, names=inputs.names, laws=inputs.laws, response=response, lowest=x.min(axis=0),
                     highest=x.max(axis=0), unit=unit)  # fmt: skip
    if not inputs.dependent:
        return made
    spread = np.linalg.inv(np.atleast_2d(np.cov(scores, rowvar=False)))
    reach = float(np.einsum("ni,ij,nj->n", scores, spread, scores).max())
    return replace(made, spread=spread, reach=reach)


def response_from(scores: Array, outputs: Array, germs: Sequence[GermLike], *, plain: bool = False) -> Response:
    """A response of outputs (n,) at rows of normal scores (n, d), in any order that tells nothing.

    Raises ValueError where none can be fitted.
    """
    points = germ_points(scores, germs)
    germs = fit_chaos(points, outputs, germs, plain=True).germs if plain else germs
    return cross_fit(points, outputs, germs, plain=plain)[0]
