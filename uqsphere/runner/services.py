"""The services of a study: each is run as the study of its own that it is, in a folder of its own."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from uqsphere.results import Results
from uqsphere.study import Study

if TYPE_CHECKING:
    from uqsphere.runner.finished import Run

#: folder of the services inside a result folder
PLACE: Final = "services"


def run_services(
    study: Study, folder: Path, seconds: float, one: Callable[[Study, Path, float], Run]
) -> tuple[dict[str, Results], float]:
    """Run every service by `one`, which takes study, folder and seconds; their results, and the seconds left.

    The seconds are shared evenly among the parts to come, the rig's own run among them.
    """
    end, left = time.monotonic() + seconds, len(study.parts)
    found: dict[str, Results] = {}
    for name, service in study.services.items():
        found[name] = one(service, folder / PLACE / name, max(end - time.monotonic(), 0.0) / left).results
        left -= 1
    return found, end - time.monotonic() if found else seconds
