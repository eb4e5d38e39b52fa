"""A finished run: its answers, samples and expansions as tables, and its plots."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from uqsphere.arrays import Array, Flags, frozen
from uqsphere.errors import UsageError

from .answers import frame_of
from .folder import read_checked, read_results
from .types import Decision, Results

if TYPE_CHECKING:
    import pandas as pd

    from uqsphere.report.figures import Plots
    from uqsphere.study import Study
    from uqsphere.uq.surrogate import Expansion

#: rows that an expansion is fitted to at most
MOST_FITTED = 512


@frozen(eq=False, repr=False)
class Run:
    """A run that has ended.

    results : what results.json holds
    folder : where it lies; None for a run that was not given a folder
    columns, study, pairs_of : what only a run of this process has: its samples, its study, and the
        runs behind the indices of a quantity, if there are such
    """

    results: Results
    folder: Path | None = None
    columns: dict[str, Array | Flags] | None = None
    study: Study | None = None
    pairs_of: Callable[[str], Any] = lambda quantity: None

    def __repr__(self) -> str:
        return (
            f"<Run {self.results.study.title!r}: {len(self.results.answers)} answers of "
            f"{self.results.accuracy.runs:,} model runs>"
        )

    def _repr_html_(self) -> str:
        """Decisions, figures and tables, for a notebook."""
        from uqsphere.report.page import run_html

        return run_html(self.results)

    @cached_property
    def answers(self) -> pd.DataFrame:
        """The long table of answers, SI units: subject, answer, at, value, low, high, low_unseen,
        high_unseen, std_error, unit, method, runs, note."""
        return frame_of(self.results.answers)

    @cached_property
    def samples(self) -> pd.DataFrame:
        """Inputs, strengths and columns of up to 16,384 rows, SI units.

        Raises FolderError where samples.csv is missing or was changed.
        """
        import pandas as pd

        if self.columns is not None:
            return pd.DataFrame(self.columns)
        assert self.folder
        return pd.read_csv(io.BytesIO(read_checked(self.folder, "samples.csv")))

    @property
    def decisions(self) -> dict[str, Decision]:
        """The decision for each aim, survive or break: verdict, number to use, what it rests on."""
        return {decision.aim: decision for decision in self.results.decisions}

    def sobol(self, quantity: str) -> pd.DataFrame:
        """First-order and total Sobol' indices of a quantity by input, with their 95 % intervals
        and the method.

        Raises UsageError for a quantity that the run has not.
        """
        first, total = (
            self._rows(quantity, f"sobol_{order}")
            .set_index("at")
            .rename_axis("input")
            .rename(columns={"value": order, "low": f"{order}_low", "high": f"{order}_high"})
            for order in ("first", "total")
        )
        ends = first[["first", "first_low", "first_high"]]
        return ends.join(total[["total", "total_low", "total_high", "method"]])

    def quantiles(self, quantity: str) -> pd.DataFrame:
        """Quantiles of a quantity with their 95 % intervals, by probability; mean and sd are in
        `answers`.
        """
        rows = self._rows(quantity, "quantile").astype({"at": float}).set_index("at")
        return rows.rename_axis("probability")[["value", "low", "high", "note"]]

    def probability(self, limit: str) -> pd.Series:
        """The failure probability of a limit or failure mode: value, low, high, low_unseen,
        high_unseen, method, note.
        """
        return self._one(limit, "failure_probability", "")

    def curve(self, limit: str) -> pd.DataFrame:
        """The probability of exceedance (fracture) over the free number, with its 95 % interval."""
        rows = self._rows(self._subject(limit), "curve").astype({"at": float}).set_index("at")
        return rows.rename_axis("free")[["value", "low", "high"]]

    def margin(self, limit: str, probability: float) -> pd.Series:
        """The free number at which a limit is exceeded with a probability: value, low, high,
        method, note.
        """
        return self._one(limit, "margin", probability)

    def expansion(self, quantity: str) -> Expansion:
        """The polynomial chaos of a quantity: `predict(rows)` with intervals, `to_frame()`
        (coefficients and multi-indices), `moments()`, `quantiles(p)`, `sample(n)`, `indices()`,
        `save(path)`, and `chaospy()` with chaospy's objects.

        It is fitted to up to 512 model runs of this run, or of its folder, when it is asked for.
        Raises UsageError where there is none: the quantity does not vary, or has no plain value in
        every row.
        """
        from uqsphere.uq.surrogate import fit_expansion

        study = self.study
        if not study:
            assert self.folder
            study = stored_study(self.folder, self.results)
        rows = self.samples.head(MOST_FITTED)
        names = list(study.random)
        if names and quantity in rows and not rows.get("censored", np.zeros(1)).any():
            x, y = (rows[part].to_numpy(dtype=float) for part in (names, quantity))
            if np.isfinite(y).all() and np.ptp(y) > 0.0:
                return fit_expansion(x, y, study.inputs().only(names), seed=study.seed)
        raise UsageError(
            f"no expansion of {quantity!r}: it does not vary, or has no plain value in every row"
        )

    def pairs(self, quantity: str) -> Any:
        """The model runs behind the indices of a quantity, as SALib takes them: `problem`, `rows`
        and `outputs`, with which `SALib.analyze.sobol.analyze(p.problem, p.outputs,
        calc_second_order=p.second)` goes on.

        Raises UsageError where there are none: the indices are those of the expansion, or the run
        was read from a folder.
        """
        made = self.pairs_of(quantity)
        if made is None:
            raise UsageError(
                f"no pairs of runs of {quantity!r}: "
                "uqsphere.to_salib(study) makes rows of the same design"
            )
        return made

    @property
    def plot(self) -> Plots:
        """Plots on matplotlib axes: `fragility`, `density`, `sobol`."""
        from uqsphere.report.figures import Plots

        return Plots(self.results)

    def _subject(self, limit: str) -> str:
        names = {subject: subject.partition(".")[2] for subject in self.results.entries}
        for subject, name in names.items():
            if limit in (subject, name):
                return subject
        known = ", ".join(names.values()) or "none"
        raise UsageError(f"no limit or failure mode {limit!r} (known: {known})")

    def _rows(self, subject: str, answer: str) -> pd.DataFrame:
        table = self.answers[self.answers["subject"] == subject]
        if table.empty:
            names = ", ".join(self.results.study.quantities)
            raise UsageError(f"the run has no answer on {subject!r} (quantities: {names})")
        return table[table["answer"] == answer]

    def _one(self, limit: str, answer: str, at: float | str) -> pd.Series:
        rows = self._rows(self._subject(limit), answer)
        if isinstance(at, str):
            rows = rows[rows["at"] == at]
        else:
            rows = rows[[isinstance(x, float) and math.isclose(x, at) for x in rows["at"]]]
        if rows.empty:
            raise UsageError(f"the run has no {answer} of {limit!r} at {at!r}")
        return rows.iloc[0][["value", "low", "high", "low_unseen", "high_unseen", "method", "note"]]


def stored_study(folder: Path, results: Results) -> Study:
    """The study that a result folder keeps; raises as `read_checked`, StudyError."""
    from uqsphere.study import load_study

    text = read_checked(folder, "study.toml").decode()
    return load_study(folder / "files" / "study.toml", results.study.overrides, text=text)


def open_run(folder: str | Path) -> Run:
    """The run in a result folder.

    Raises FolderError where there is none or it is damaged, AccessError where it cannot be read.

    >>> open_run("nowhere")
    Traceback (most recent call last):
    ...
    uqsphere.errors.FolderError: nowhere does not contain results.json
    """
    path = Path(folder)
    return Run(results=read_results(path), folder=path)
