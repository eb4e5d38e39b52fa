"""The product of crushing in a study: t10 is answered where [product] gives A and b, and nowhere else."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from uqsphere.study.document import Document
from uqsphere.study.faults import Findings, Place
from uqsphere.study.study import Analysis

__all__ = ["with_product"]

FINENESS: Final = "t10"


def with_product(analysis: Analysis, document: Document, findings: Findings) -> Analysis:
    """The analysis with t10 among its quantities where the study has a product; a fault where it is asked without."""
    if document.product is not None:
        return replace(analysis, quantities=tuple(dict.fromkeys([*analysis.quantities, FINENESS])))
    given = document.analysis.quantities or []
    places: list[Place] = [("analysis", "quantities", given.index(FINENESS))] if FINENESS in given else []
    places += [("limits", name, "quantity") for name, table in document.limits.items() if table.quantity == FINENESS]
    for place in places:
        if findings.clean(("product",)):
            findings.add(place, 't10 needs a table [product] with A = "55 %" and b = "0.8 t/kWh", or laws')
    return analysis
