"""When a study may go on with the evaluations of another one."""

from __future__ import annotations

from typing import Any, Final

__all__ = ["why_not_extended"]

#: what has to be the same: the rest is what is asked of the evaluations, and how precisely
_SAME: Final = ("kind", "seed", "fixed", "options", "outputs", "record")
_SAME_MODEL: Final = ("tolerance", "first_loading_only", "horizon")


def why_not_extended(before: dict[str, Any], now: dict[str, Any]) -> str:
    """What keeps a study from extending another, from what both mean (`Study.resolved`); empty if nothing does.

    The seed, every number of the scene, their laws in their order, and how precisely the motion is computed must be
    the same.  Accuracy, budget, limits, quantities, quantiles, methods and margins may change.  That is a rule for
    people: a stored evaluation is used only where the very same one is due, whatever this says.

    >>> why_not_extended({"seed": 1}, {"seed": 2})
    'the seed differs'
    """
    for key in _SAME:
        if before.get(key) != now.get(key):
            which = _which(before.get(key), now.get(key))
            return f"{which or f'the {key}'} differs"
    laws_before, laws_now = _scene_laws(before), _scene_laws(now)
    if laws_before != laws_now:
        return f"{_which(laws_before, laws_now)} differs"
    if list(laws_before) != list(laws_now):
        return "the order of the random inputs differs"
    for key in _SAME_MODEL:
        if (before.get("model") or {}).get(key) != (now.get("model") or {}).get(key):
            return f"model.{key} differs"
    return ""


def _scene_laws(resolved: dict[str, Any]) -> dict[str, Any]:
    """The laws of the model's own inputs: strengths and model factors belong to limits."""
    laws = resolved.get("random")
    if not isinstance(laws, dict):
        return {}
    order = resolved.get("order", list(laws))
    return {name: laws.get(name) for name in order if not str(name).startswith("limits.")}


def _which(before: Any, now: Any) -> str:
    """The first name whose entry differs."""
    if not isinstance(before, dict) or not isinstance(now, dict):
        return ""
    names = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    return str(names[0]) if names else ""
