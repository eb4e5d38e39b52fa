"""Study files: TOML text → validated, frozen `Study` in SI, with every fault of a file located and told at once."""

from __future__ import annotations

from pathlib import Path

from uqsphere.study.document import Accuracy, Analysis, Budget, Dependence, Gauge, ModelChoice
from uqsphere.study.faults import Raw
from uqsphere.study.resolve import load_study
from uqsphere.study.study import (
    ENERGY,
    SPEED,
    Axis,
    EndImpedance,
    Family,
    Limit,
    Margins,
    Source,
    Study,
    Way,
    Ways,
    breaks_by,
    law_json,
    limit_of,
    means_fracture,
    quantity_of,
    spaced,
    strength_name,
    ways_of,
    with_number,
)

__all__ = [
    "ENERGY", "SPEED", "Accuracy", "Analysis", "Axis", "Budget", "Dependence", "EndImpedance", "Family", "Gauge",
    "Limit", "Margins", "ModelChoice", "Source", "Study", "Way", "Ways", "breaks_by", "json_schema", "law_json",
    "limit_of", "load_study", "means_fracture", "quantity_of", "shipped_studies", "spaced", "strength_name",
    "ways_of", "with_number",
]  # fmt: skip


def json_schema() -> dict[str, Raw]:
    """JSON schema of a study file (draft 2020-12) for editors: scene and black box, with units and meanings."""
    from uqsphere.study.reference import build_schema

    return build_schema()


def shipped_studies() -> dict[str, Path]:
    """Shipped studies by name: beside the package when installed, in the repository otherwise."""
    package = Path(__file__).parent.parent
    for folder in (package / "templates", package.parent / "studies"):
        found = {path.stem: path for path in sorted(folder.glob("*.toml"))}
        if found:
            return found
    return {}
