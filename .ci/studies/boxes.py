"""The models of the black-box studies beside this file: cheap functions, one for each way of answering."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def ishigami(inputs: dict[str, Array]) -> dict[str, Array]:
    """Smooth: chaos follows it."""
    x1, x2, x3 = inputs["x1"], inputs["x2"], inputs["x3"]
    return {"y": np.sin(x1) + 7.0 * np.sin(x2) ** 2 + 0.1 * x3**4 * np.sin(x1)}


def rough(inputs: dict[str, Array]) -> dict[str, Array]:
    """One smooth output, and one with steps that no polynomial follows."""
    x1, x2 = inputs["x1"], inputs["x2"]
    steps = np.where(np.sin(7.0 * x1) * np.sin(9.0 * x2) > 0.0, 8.0, 0.0)
    return {"smooth": np.exp(0.3 * x1) + x2, "rough": np.sin(x2) + steps}


def margin(inputs: dict[str, Array]) -> dict[str, Array]:
    """A limit state that fails below zero, seldom."""
    return {"g": inputs["resistance"] - inputs["load"] * (1.0 + 0.1 * inputs["load"])}


def beam(inputs: dict[str, Array]) -> dict[str, Array]:
    """Deflection and stress under a load whose parts depend on each other."""
    load, length, depth = inputs["load"], inputs["length"], inputs["depth"]
    return {"deflection": load * length**3 / depth**3, "stress": load * length / depth**2}


def tails(inputs: dict[str, Array]) -> dict[str, Array]:
    """An answer without a second moment."""
    return {"y": inputs["t"] + 0.5 * inputs["x"], "calm": inputs["x"] ** 2}


def holes(inputs: dict[str, Array]) -> dict[str, Array]:
    """No answer in a corner of the inputs."""
    y = inputs["x1"] * inputs["x2"] + inputs["x1"]
    return {"y": np.where(inputs["x1"] + inputs["x2"] > 3.85, np.nan, y)}
