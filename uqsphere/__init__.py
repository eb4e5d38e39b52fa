"""Fracture risk and uncertainty of brittle spheres under impact: contact pressure, contact
duration, strength.

>>> import uqsphere
>>> study = uqsphere.load_study("studies/granite.toml")
>>> study.title
'Granite, 20 mm, between 40 mm steel bars'
"""

TYPE_CHECKING = False  # that of typing, whose import can be interrupted
if TYPE_CHECKING:
    from uqsphere import analysis
    from uqsphere.exchange import analyse, design, joint, sample, to_salib
    from uqsphere.models.evaluate import evaluate
    from uqsphere.propagation import run
    from uqsphere.propagation.fragility import fragility_curves
    from uqsphere.report.history import history
    from uqsphere.results import Run, open_run
    from uqsphere.study import Study, load_study

__all__ = [
    "Run",
    "Study",
    "analyse",
    "analysis",
    "design",
    "evaluate",
    "fragility_curves",
    "history",
    "joint",
    "load_study",
    "open_run",
    "run",
    "sample",
    "to_salib",
]

__version__ = "0.2.0"

#: where each public name lives; loaded when it is first used, since some take a second to import
_HOMES = {
    "Run": "uqsphere.results",
    "Study": "uqsphere.study",
    "analyse": "uqsphere.exchange",
    "design": "uqsphere.exchange",
    "evaluate": "uqsphere.models.evaluate",
    "fragility_curves": "uqsphere.propagation.fragility",
    "history": "uqsphere.report.history",
    "joint": "uqsphere.exchange",
    "load_study": "uqsphere.study",
    "open_run": "uqsphere.results",
    "run": "uqsphere.propagation",
    "sample": "uqsphere.exchange",
    "to_salib": "uqsphere.exchange",
}


def __getattr__(name: str) -> object:
    from importlib import import_module

    if name == "analysis":
        return import_module("uqsphere.analysis")
    if name not in _HOMES:
        raise AttributeError(f"module 'uqsphere' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
