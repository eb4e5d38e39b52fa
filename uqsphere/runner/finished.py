"""A finished run, as its folder has it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from uqsphere.errors import FolderError
from uqsphere.files import refuse_links
from uqsphere.results import Results, read_results
from uqsphere.results.entries import Manifest, read_manifest
from uqsphere.store import read_json

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, kw_only=True)
class Run:
    """A finished run: its folder, the content of results.json and of manifest.json."""

    folder: Path
    results: Results
    manifest: Manifest

    @property
    def met(self) -> bool:
        """Whether the verdict on every limit with a target is that it is met, of services too."""
        limits = [limit for part in self.results.parts.values() for limit in part.limits.values()]
        return all(limit.verdict == "met" for limit in limits if limit.target is not None)

    @property
    def services(self) -> dict[str, Run]:
        """The runs of the study's services, as their own folders have them."""
        return {name: open_run(self.folder / "services" / name) for name in self.results.services}

    def _table(self, name: str) -> pd.DataFrame:
        from uqsphere.runner.export import read_table

        return read_table(self.folder, name)

    def samples(self) -> pd.DataFrame:
        """Rows that were sampled: inputs (SI), quantities (SI), status, censored flags."""
        from uqsphere.runner.samples import load_samples

        return load_samples(self.folder)

    def indices(self) -> pd.DataFrame:
        """First and total Sobol' indices with their intervals."""
        return self._table("sensitivity")

    def limits(self) -> pd.DataFrame:
        """Probabilities and margins of every limit with their intervals."""
        return self._table("limits")

    def margins(self) -> pd.DataFrame:
        """Values of the free scalar at the probabilities asked for."""
        return self._table("margins")


def open_run(folder: str | Path) -> Run:
    """A finished run from its folder.

    Raises
    ------
    FolderError
        When the folder is no result folder, or its run has not finished.
    """
    path = Path(folder)
    if not path.is_dir():
        raise FolderError(f"{path} is not a result folder")
    refuse_links(path)
    if not (path / "results.json").is_file() and (path / "study.resolved.json").is_file():
        raise FolderError(f"the run in {path} has not finished: run the study again to go on with it")
    results = read_results(path)
    mark = read_json(path / "study.resolved.json") if (path / "study.resolved.json").is_file() else {}
    if isinstance(mark, dict) and mark.get("hash", results.study.hash) != results.study.hash:
        raise FolderError(f"the run in {path} that extends another has not finished: run the study again")
    return Run(folder=path, results=results, manifest=read_manifest(path))
