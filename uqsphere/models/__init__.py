"""Models: rows of inputs go in, columns of answers come out. The only place where physics meets probability.

What is public is imported when it is used: a process that calls a black box needs neither studies nor mechanics.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from uqsphere.models.black_box import load_black_box, model_digest
    from uqsphere.models.diagnose import (
        absent_quantity,
        checked_rows,
        fractures_of,
        hardness_of,
        later_loading,
        rows_under_plastic_contact,
    )
    from uqsphere.models.model import Model, open_model
    from uqsphere.models.rows import EvaluatedRows, Interrupted, status_text
    from uqsphere.models.scene import check_quantities, check_range, evaluate, scene_of, solve_scene

__all__ = [
    "EvaluatedRows", "Interrupted", "Model", "absent_quantity", "check_quantities", "check_range",
    "checked_rows", "evaluate", "fractures_of", "hardness_of", "later_loading", "load_black_box", "model_digest",
    "open_model", "rows_under_plastic_contact", "scene_of", "solve_scene", "status_text",
]  # fmt: skip

_FILES: Final = {
    "black_box": ("load_black_box", "model_digest"),
    "diagnose": (
        "absent_quantity",
        "checked_rows",
        "fractures_of",
        "hardness_of",
        "later_loading",
        "rows_under_plastic_contact",
    ),
    "model": ("Model", "open_model"),
    "rows": ("EvaluatedRows", "Interrupted", "status_text"),
    "scene": ("check_quantities", "check_range", "evaluate", "scene_of", "solve_scene"),
}


def __getattr__(name: str) -> Any:
    for file, names in _FILES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{file}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
