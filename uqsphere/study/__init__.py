"""Study files: TOML text → validated, frozen `Study` in SI, with faults at their lines, a stage of
them at once.
"""

from pathlib import Path

from .document import VALUES, json_schema, limit_of
from .load import load_study
from .study import Limit, Study, default_target
from .values import mean_of

__all__ = [
    "VALUES",
    "Limit",
    "Study",
    "default_target",
    "json_schema",
    "limit_of",
    "load_study",
    "mean_of",
    "shipped_studies",
]


def shipped_studies() -> dict[str, Path]:
    """Shipped studies by name, but for the labs' input files: in the package when installed, else
    in the repository.
    """
    package = Path(__file__).parent.parent
    folder = package / "templates"
    if not folder.is_dir():
        folder = package.parent / "studies"
    return {
        path.stem: path
        for path in sorted(folder.glob("*.toml"))
        if not path.stem.startswith("lab_")
    }
