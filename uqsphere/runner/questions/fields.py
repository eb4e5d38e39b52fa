"""Answers that are vectors (`analysis.fields`): their bands, indices over places and of all places, in fields.nc."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.model import place_names
from uqsphere.results import AnalysisEntry, Est
from uqsphere.results.tables import Stored, save_fields
from uqsphere.runner.courses import followed
from uqsphere.runner.evaluate import Work, draw, evaluate_whole
from uqsphere.store import Store
from uqsphere.study import Study
from uqsphere.uq.expansion import germ_points
from uqsphere.uq.fields import FieldAnswer, answer_field

#: rows of a field, and the fewest that are cross-fitted: a smooth one is known to 1e-4 of its variance from 128
RUNS: Final = 128
LEAST: Final = 32
#: quantiles of the band
LEVELS: Final = (0.05, 0.5, 0.95)


def planned(study: Study) -> int:
    """Evaluations: half of the budget at most.  Force histories are followed beside those that count."""
    return max(min(RUNS, study.analysis.budget.evaluations // 2), LEAST) if study.black_box else 0


def answer(work: Work) -> AnalysisEntry:
    """Aggregated indices by field and input; bands and indices at every place go to fields.nc and tables/fields.csv.

    Where inputs depend on each other there are bands and no indices: their germs are not those of the inputs.
    """
    names, fields = work.scene_names, work.study.analysis.fields
    inputs = work.all_inputs.only(names)
    count = planned(work.study) or RUNS
    sample = draw(inputs, seed=work.study.seed, task="fields", start=0, count=count, replicates=1)
    rows, scores = sample.inputs[0], sample.scores[0]
    found = _of_black_box(work, rows) if work.study.black_box else _of_scene(work, rows)
    if isinstance(found, str):
        return AnalysisEntry(reason=found)
    tied, table, stored = bool(inputs.tied()), {}, {}
    for name in fields:
        places, values = found[name]
        whole = np.isfinite(values).all(axis=1)
        if whole.sum() < LEAST:
            return AnalysisEntry(reason=f"{int(whole.sum())} of {count} rows have a whole {name}: {LEAST} are due")
        one = answer_field(germ_points(scores[whole], work.germs), values[whole], work.germs, LEVELS,
                           seed=work.study.seed)  # fmt: skip
        stored[name] = Stored(answer=one, places=places, inputs=() if tied else names)
        table[name] = {} if tied else _indices(one, names)
    if isinstance(work.store, Store):
        save_fields(work.store.folder, stored)
    return AnalysisEntry(values=table)


def _indices(one: FieldAnswer, names: tuple[str, ...]) -> dict[str, dict[str, Est]]:
    columns = {"aggregated first": one.aggregated_first, "aggregated total": one.aggregated_total}
    return {
        name: {column: Est.model_validate(estimates[j]) for column, estimates in columns.items()}
        for j, name in enumerate(names)
    }


def _of_black_box(work: Work, rows: Array) -> dict[str, tuple[Array, Array]] | str:
    """Places (m,) and answers (n, m) of every field: columns of one more question, stored as those of outputs are."""
    fields, study = work.study.analysis.fields, work.study
    columns = tuple(column for name, places in fields.items() for column in place_names(name, places))
    asked = replace(work, study=replace(study, outputs=columns), columns=columns)
    answered = evaluate_whole(asked, "fields", rows)
    if isinstance(answered, str):
        return answered
    values = answered.known
    ends = np.cumsum(list(fields.values()))[:-1]
    parts = np.split(values, ends, axis=1)
    return {name: (np.arange(float(fields[name])), part) for name, part in zip(fields, parts, strict=True)}


def _of_scene(work: Work, rows: Array) -> dict[str, tuple[Array, Array]] | str:
    """Instants (m,) of the first loading and the contact forces (n, m)."""
    answer = {}
    for name, places in work.study.analysis.fields.items():
        found = followed(work, rows, places)
        if found is None:
            return "the scenes cannot be followed over time by this fidelity"
        answer[name] = found[0], found[1][:, ("force_a", "force_b").index(name)]
    return answer
