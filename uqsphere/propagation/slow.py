"""What the rows of a slow model answer, with the expansions that are fitted to them."""

from collections.abc import Callable, Mapping
from dataclasses import replace

from uqsphere.arrays import Array, frozen
from uqsphere.results.types import IndexMethod
from uqsphere.uq import Estimate, Sample, absent
from uqsphere.uq.corrected import Corrected, indices_of
from uqsphere.uq.describe import Description, describe
from uqsphere.uq.estimate import count_bound
from uqsphere.uq.response import Response, unseen

from .design import Design

ROUGH = "runs of the model"


def described_rows(design: Design, sample: Sample, name: str, method: str) -> Description:
    """The description of a quantity by the rows of a sample alone."""
    return describe(
        sample.answer(name),
        censored=sample.late(name),
        on_failure=design.on_failure,
        quantiles=design.study.analysis.quantiles,
        method=method,
    )


@frozen(eq=False)
class Slow:
    """What answers the questions that `uqsphere.propagation.tables.Tables` answers of a cheap
    model.

    Attributes
    ----------
    rows : (1, N) as evaluated
    responses : the expansions by quantity; none where a row has no plain values
    sample : the table: predictions with residuals on them, or the rows in blocks
    predicted : (R, m) predictions of all columns at points of the law; None where the expansions of
        a column are too rough
    dropped : share of the rows that failed and were left out
    """

    design: Design
    rows: Sample
    responses: Mapping[str, Response]
    sample: Sample
    predicted: Sample | None
    dropped: float

    def corrected(self, name: str) -> Corrected | None:
        """The predictions of a quantity, corrected by its rows; None where it has none."""
        if self.predicted is None:
            return None
        return Corrected(
            response=self.responses[name],
            table=self.predicted.answer(name),
            dropped=self.dropped,
        )

    def values(self, name: str) -> Array:
        """Values (R, n) that stand for the distribution of a quantity."""
        return self.sample.answer(name)

    def describe(self, name: str) -> Description:
        """Mean, standard deviation and quantiles of a quantity."""
        corrected = self.corrected(name)
        if corrected is not None:
            return corrected.describe(self.design.study.analysis.quantiles)
        method = f"{self.rows.size} {ROUGH}{self._kept}; {unseen(self.rows.size)}"
        return described_rows(self.design, self.sample, name, method)

    @property
    def _kept(self) -> str:
        if not self.dropped:
            return ""
        return f", the {100.0 * (1.0 - self.dropped):.3g} % of rows that answered"

    def probability(
        self, column: str, sampled: Estimate, chance: Callable[[Sample], Array]
    ) -> Estimate:
        """A failure probability.

        column : what the limit is held against
        sampled : the probability of the sample
        chance : the failure probability (R, n) given the inputs and outputs of a sample
        """
        corrected = self.corrected(column)
        predicted = self.predicted
        if corrected is None or predicted is None:
            sampled = replace(sampled, method=sampled.method + self._kept)
            if sampled.high is None:
                return sampled
            return replace(sampled, high=max(sampled.high, count_bound(self.rows.size)))
        place = predicted.quantities.index(column)

        def moved(sample: Sample, values: Array) -> Array:
            answers = sample.answers.copy()
            answers[:, :, place] = values
            return chance(sample.with_answers(sample.quantities, answers))

        return corrected.probability(
            rows=chance(self.rows)[0],
            left_out=moved(self.rows, corrected.response.levels)[0],
            table=lambda residual: moved(predicted, corrected.table + residual),
        )

    def index_method(self, name: str) -> IndexMethod:
        """Where the indices of a quantity come from."""
        return "chaos" if name in self.responses else ""

    def indices(self, name: str) -> Mapping[str, tuple[Estimate, ...]]:
        """First and total indices of a quantity for independent inputs."""
        runs = self.rows.size
        inputs = self.design.inputs
        if name in self.responses:
            orders = indices_of(self.responses[name]).values()
            return {
                label: tuple(replace(index, method=index.method + self._kept) for index in row)
                for label, row in zip(inputs, zip(*orders, strict=True), strict=True)
            }
        reason = f"some of the {runs} model runs have no plain value"
        if self.dropped:
            reason = "the runs that failed lie apart from the others: see on_failure"
        elif self.rows.failed.any():
            reason += '; analysis.on_failure = "drop" gives the indices of those that do'
        nothing = absent(reason, ROUGH, runs)
        return dict.fromkeys(inputs, (nothing, nothing))
