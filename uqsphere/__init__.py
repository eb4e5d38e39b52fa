"""Fracture risk and uncertainty quantification for brittle spheres between split Hopkinson bars.

>>> import uqsphere
>>> study = uqsphere.load_study("studies/granite.toml")
>>> study.title
'Granite, 20 mm, between 40 mm steel bars'
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uqsphere import analysis
    from uqsphere.model import evaluate
    from uqsphere.runner.api import run
    from uqsphere.runner.deterministic import history_of as history
    from uqsphere.runner.finished import Run, open_run
    from uqsphere.study import Study, load_study
    from uqsphere.uq.surrogate import Surrogate, load_surrogate

__all__ = [
    "Run",
    "Study",
    "Surrogate",
    "analysis",
    "evaluate",
    "history",
    "load_study",
    "load_surrogate",
    "open_run",
    "run",
]

__version__ = "0.1.0"

#: where each public name lives; loaded when it is first used, since some take a second to import
_HOMES = {
    "Run": ("uqsphere.runner.finished", "Run"),
    "Study": ("uqsphere.study", "Study"),
    "Surrogate": ("uqsphere.uq.surrogate", "Surrogate"),
    "evaluate": ("uqsphere.model", "evaluate"),
    "history": ("uqsphere.runner.deterministic", "history_of"),
    "load_study": ("uqsphere.study", "load_study"),
    "load_surrogate": ("uqsphere.uq.surrogate", "load_surrogate"),
    "open_run": ("uqsphere.runner.finished", "open_run"),
    "run": ("uqsphere.runner.api", "run"),
}


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name == "analysis":
        return import_module("uqsphere.analysis")
    if name not in _HOMES:
        raise AttributeError(f"module 'uqsphere' has no attribute {name!r}")
    module, attribute = _HOMES[name]
    return getattr(import_module(module), attribute)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
