"""A surrogate whose indices are known exactly, as control variate of sampled Sobol' indices.

Indices read off an expansion are those of the expansion: what it leaves out is missing from them, and an interval from
the spread of several fits does not know of it.  As control variate the same expansion sharpens an answer that remains
that of the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.expansion import Chaos, germ_points, predict
from uqsphere.uq.indices import Blocks, Surrogate

__all__ = ["chaos_outputs", "chaos_surrogate", "expansion_indices", "mean_expansion"]


def expansion_indices(coefficients: Array, multi_indices: npt.NDArray[np.int64], blocks: Blocks) -> dict[str, Array]:
    """Indices of an expansion in products of orthonormal polynomials, exactly: what a `Surrogate` is known by.

    Parameters
    ----------
    coefficients : (P,) array
    multi_indices : (P, d) array
        Degrees of each product; the constant has none.
    blocks : Blocks

    >>> degrees = np.array([[0, 0], [1, 0], [1, 1]])
    >>> found = expansion_indices(np.array([5.0, 3.0, 1.0]), degrees, Blocks(inputs_count=2, second=True))
    >>> found["first"].tolist(), found["total"].tolist(), found["second"].tolist()
    ([0.9, 0.0], [1.0, 0.1], [0.1])
    """
    active = multi_indices > 0
    count = active.sum(axis=1)
    varying = np.where(count > 0, coefficients, 0.0)
    # by a power of two, which rounds nothing: the squares of 1e300 are beyond floating point
    shares = np.ldexp(varying, -np.frexp(np.abs(varying).max())[1]) ** 2
    shares = shares / shares.sum()
    rows, columns = np.triu_indices(blocks.inputs_count, 1) if blocks.second else (np.array([], int),) * 2
    inside = [active[:, list(group)].sum(axis=1) for group in blocks.groups]
    return {
        "first": np.asarray(shares @ (active & (count == 1)[:, None])),
        "total": np.asarray(shares @ active),
        "second": np.asarray(shares @ (active[:, rows] & active[:, columns] & (count == 2)[:, None])),
        "group_first": np.array([shares[k == count].sum() for k in inside]),
        "group_total": np.array([shares[k > 0].sum() for k in inside]),
    }


def mean_expansion(fits: Sequence[Chaos]) -> Chaos:
    """The mean of plain expansions in the same germs: their terms together, each with its mean coefficient.

    Raises ValueError for an expansion of a transformed output or in two pieces: its indices are not known exactly.
    """
    if not all(fit.plain for fit in fits):
        raise ValueError("a control variate takes expansions of the output itself, in one piece: fit them with plain")
    degrees = np.concatenate([fit.multi_indices for fit in fits])
    values = np.concatenate([fit.coefficients for fit in fits]) / len(fits)
    terms, place = np.unique(degrees, axis=0, return_inverse=True)
    coefficients = np.zeros(len(terms))
    np.add.at(coefficients, place.reshape(-1), values)
    # the constant first, as in every expansion: np.unique sorts it there
    piece = replace(fits[0].pieces[0], coefficients=coefficients, multi_indices=terms)
    return replace(fits[0], pieces=(piece,), samples=sum(f.samples for f in fits))


def chaos_outputs(chaos: Chaos, blocks: Blocks, halves: Sequence[Array]) -> Array:
    """Values (N, blocks.count) of an expansion on the blocks of halves of independent standard normals, (N, d) each."""
    points = blocks.mix(*(germ_points(half, chaos.germs) for half in halves))
    return predict(chaos, points.reshape(-1, blocks.inputs_count)).reshape(-1, blocks.count)


def chaos_surrogate(chaos: Chaos, blocks: Blocks, outputs: Array) -> Surrogate | None:
    """An expansion with its `chaos_outputs` (R, N, blocks.count) as a surrogate; None where it is a constant."""
    if not chaos.coefficients[chaos.multi_indices.any(axis=1)].any():
        return None
    return Surrogate(outputs=outputs, indices=expansion_indices(chaos.coefficients, chaos.multi_indices, blocks))
