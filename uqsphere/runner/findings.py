"""All that a run found, by the questions that found it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from uqsphere.results import AnalysisEntry, CheckEntry, FractureEntry, ToleranceEntry
from uqsphere.results.entries import CarriedEntry

if TYPE_CHECKING:
    from uqsphere.runner.drivers import Drivers
    from uqsphere.runner.evidence import Evidence
    from uqsphere.runner.fidelity import Pilot
    from uqsphere.runner.questions.distributions import Sampled
    from uqsphere.runner.questions.indices import Sensitivity
    from uqsphere.runner.questions.margins import MarginAnswer
    from uqsphere.runner.similarity import Tabled
    from uqsphere.runner.verdict import Unsure


@dataclass(frozen=True, kw_only=True)
class Findings:
    """All that a run found, before it is written down."""

    pilot: Pilot
    sampled: Sampled
    sensitivity: dict[str, Sensitivity]
    drivers: Drivers
    tabled: Tabled
    margins: dict[str, MarginAnswer] = field(default_factory=dict)
    tolerance: dict[str, ToleranceEntry] = field(default_factory=dict)
    analyses: dict[str, AnalysisEntry] = field(default_factory=dict)
    stops: dict[str, str] = field(default_factory=dict)
    evidence: Evidence | None = None
    fracture: FractureEntry | None = None
    carried: Mapping[str, CarriedEntry] = field(default_factory=dict)
    far: Sequence[CheckEntry] = ()
    unsure: Unsure | None = None

    @property
    def curves_tabled(self) -> list[Tabled]:
        """The tables beside the rows of curves: limits that share their rows share one."""
        bands = [band for one in self.margins.values() for band in (one.band, *one.bands.values()) if band is not None]
        return list({id(band.tabled): band.tabled for band in bands}.values())
