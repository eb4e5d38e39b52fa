"""The words of the trade that a page uses, each in a plain sentence."""

from __future__ import annotations

import html
import re
from typing import Final

__all__ = ["GLOSSARY", "words_used"]

#: (word, what it is found by, its meaning), in the order of the alphabet
GLOSSARY: Final[tuple[tuple[str, str, str], ...]] = (
    ("Borgonovo’s δ", r"Borgonovo",
     "How far a quantity’s distribution moves, on average, once an input is known: 0 not at all, 1 wholly."),
    ("case", r"\bcases?\b",
     "One combination of all the random numbers of the study, as one test in the laboratory would be; also called a "
     "sample where it was computed, and a scene where its motion was followed."),
    ("censored", r"censored|outlast",
     "Known as a lower bound only, because the record ended first."),
    ("characteristic value", r"characteristic",
     "Here the 5 % quantile of a strength (95 % where the aim is to break), and the median of a load; the design value "
     "is that of the design point."),
    ("coefficient of variation", r"coefficient of variation",
     "Standard deviation over mean."),
    ("control variate", r"control variate",
     "A cheaper model, computed beside the dear one, whose known mean takes scatter out of the estimate."),
    ("demand", r"\bdemand\b",
     "What the impact asks of the sphere, the quantity that a limit compares with the strength."),
    ("design point", r"\bdesign point",
     "Of all combinations of inputs that miss the aim, the likeliest; the reliability index is its distance."),
    ("direction cosines, importance factor", r"direction cosines|importance factor",
     "How much of the way from the means to the design point goes along each input; squared they sum to one. Standard "
     "normal space is where every input is measured in its own standard deviations, made independent."),
    ("first and total index (Sobol’)", r"first index|total index|first \(alone\)|Sobol’ ind",
     "Shares of the variance of a quantity: what an input causes alone, and what it causes with all its interactions."),
    ("force difference", r"force[_ ]balance|contact forces differ",
     "Difference of the forces at both faces of the sphere over the largest force."),
    ("fragility", r"[Ff]ragility",
     "The probability that the limit is exceeded, over a number such as the speed."),
    ("full, massless, linear (model)", r"\bmassless\b|\blinear model|model is full|model is linear",
     "Full: the sphere’s own inertia counts and both contacts are nonlinear. Massless: its inertia is left out. "
     "Linear: its contacts are springs of one stiffness, so that the motion is known in closed form."),
    ("Gaussian copula", r"[Gg]aussian copula",
     "The way in which two numbers depend on each other: as two normal numbers of that correlation, each then turned "
     "into its own law."),
    ("Kucherenko’s indices", r"Kucherenko",
     "First and total index of inputs that depend on each other."),
    ("law", r"\blaws?\b",
     "How a random number is distributed, with its kind and its parameters."),
    ("margin", r"\b[Mm]argins?\b",
     "Strength over demand: above one the sphere withstands, below one it breaks."),
    ("modulus (Weibull)", r"\bmodulus\b.{0,40}\b(scale|mean|threshold)|[Ww]eibull",
     "How little a strength of this law scatters: the larger, the narrower; no relation to Young’s modulus."),
    ("paper", r"\bpaper\b",
     "W. K. Nowacki, Dynamic compression of a brittle spherical specimen, Engng. Trans. 42(3), 263–279, 1994: "
     "the theory that this model corrects; Roman numbers are those of the errata in the program’s documents."),
    ("PAWN", r"\bPAWN\b",
     "The largest gap between the distribution of a quantity and the same with an input known."),
    ("pilot sample", r"\bpilot\b",
     "A small first sample, from which the model, the way of computing and the validity are judged."),
    ("polynomial chaos", r"[Pp]olynomial chaos",
     "The answer written as a sum of polynomials of the inputs, of so many terms and such a degree; a surrogate."),
    ("profile likelihood", r"profile likelihood",
     "An interval of a fitted parameter that holds every value under which the tests are not too unlikely."),
    ("quantile", r"\bquantiles?\b",
     "The value that a given share of the cases stays below."),
    ("rank correlation (Spearman)", r"[Ss]pearman",
     "How far two numbers rise together, from −1 to 1, judged by their order alone."),
    ("reliability index β", r"[Rr]eliability index",
     "A small probability as a number of standard deviations of the normal law: 2.3 is 1 %, 3.1 is 0.1 %."),
    ("Shapley effect", r"Shapley",
     "The share of the variance that belongs to an input; they sum to one even where inputs depend on each other."),
    ("standard error", r"standard error",
     "The standard deviation of an estimate; a 95 % interval reaches about two of them to each side."),
    ("surrogate", r"\bsurrogate",
     "A formula fitted to some evaluations of the model, that answers in its place."),
    ("violin", r"\b[Vv]iolins?\b",
     "In a figure of indices, the bulge that shows where an index is likely to lie; its whisker is the 95 % interval."),
    ("a/r", r"\ba/r\b", "Radius of the contact circle over that of the sphere."),
    ("p, p_max, p_0", r"\bp_max\b|\bp_0\b",
     "Contact pressure in the centre of the circle: p_0 at any instant, p_max the largest of both faces. P is a force: "
     "P_0 the force scale, P_max the largest force. A lone p in a fit of tests is the probability of a worse fit."),
    ("t_c, θ", r"\bt_c\b|\bθ\b|\btheta\b",
     "Time scale of the contact, and the time t_i for which the pulse lasts over it."),
    ("Z, v_0, c_0", r"\bv_0\b|\bc_0\b",
     "Impedance of a bar (force over the speed of its end), the speed that the pulse brings, the speed of waves in the "
     "bar."),
)  # fmt: skip

_TAG: Final = re.compile(r"<style>.*?</style>|<[^>]*>", re.DOTALL)


def words_used(page: str) -> list[tuple[str, str]]:
    """The entries of the glossary that the text of a page (HTML, without drawings) asks for, in their order."""
    text = re.sub(r"\s+", " ", html.unescape(_TAG.sub(" ", page)))
    return [(word, meaning) for word, found, meaning in GLOSSARY if re.search(found, text)]
