"""What results.json holds of the answers of inverse questions."""

from __future__ import annotations

from pydantic import Field, StrictBool, StrictStr

from uqsphere.results.entries import (
    CheckEntry,
    Count,
    Curve,
    Entry,
    Est,
    Ests,
    Maybe,
    Name,
    Number,
    Part,
    Quantiles,
    Share,
    ShareKey,
)


class LognormalEntry(Part):
    """The lognormal curve beside a computed one, or why there is none."""

    NEEDS = ("median", "dispersion")

    median: Maybe[Est] = Field(default_factory=Est)
    dispersion: Maybe[Est] = Field(default_factory=Est)
    rising: StrictBool | None = None
    largest_gap: Number = 0.0
    largest_gap_at: Number = 0.0
    reason: StrictStr | None = None


class BandEntry(Part):
    """How well a curve is known."""

    NEEDS = ("half_width", "asked", "evaluations")

    half_width: Number = 0.0
    asked: Number = 0.0
    evaluations: Count = 0
    needed: Number | None = None


class StepsEntry(Part):
    """How far apart the values of a curve lie."""

    NEEDS = ("step", "asked", "evaluations", "needed")

    step: Number = 0.0
    asked: Number = 0.0
    evaluations: Number = 0.0
    needed: Number = 0.0


class MemberEntry(Entry):
    """A curve at another value of another number."""

    value: Number
    values: Quantiles
    curve: Curve
    lognormal: Maybe[LognormalEntry] = Field(default_factory=LognormalEntry)
    reason: StrictStr | None = None
    band: Maybe[BandEntry] = Field(default_factory=BandEntry)
    steps: Maybe[StepsEntry] = Field(default_factory=StepsEntry)


class FamilyEntry(Part):
    """Curves at other values of another number."""

    NEEDS = ("path", "members")

    path: StrictStr = ""
    members: tuple[MemberEntry, ...] = ()


class AgainstEntry(Part):
    """The curve over another quantity than the free scalar."""

    NEEDS = ("quantity", "unit", "values", "curve")

    quantity: StrictStr = ""
    unit: StrictStr = ""
    values: Quantiles = Field(default_factory=dict)
    curve: Curve = ()
    lognormal: Maybe[LognormalEntry] = Field(default_factory=LognormalEntry)
    reason: StrictStr | None = None


class FractilesOf(Part):
    """Which fractiles a factor is the ratio of."""

    NEEDS = ("strength", "demand")

    strength: Share = 0.0
    demand: Share = 0.0


class FactorsEntry(Part):
    """Strength over demand: of their medians, and of two fractiles."""

    medians: Number = 0.0
    fractiles: Number = 0.0
    fractiles_of: Maybe[FractilesOf] = Field(default_factory=FractilesOf)
    reason: StrictStr | None = None


class PartialFactor(Entry):
    """An input at the design point, its characteristic value, and their ratio."""

    design: Number
    characteristic: Number
    factor: Number


class LostEntry(Part):
    """Which inputs a margin is lost to: importance factors and partial factors."""

    shares: dict[Name, Number] = Field(default_factory=dict)
    partial: dict[Name, PartialFactor] = Field(default_factory=dict)
    reason: StrictStr | None = None


class MarginOpenEntry(Part):
    """What few tests leave open of the value; `sure` holds with the confidence given."""

    tests: Count = 0
    stopped: Count = 0
    laws: Count = 0
    low: Number | None = None
    high: Number | None = None
    sure: Number | None = None
    confidence: Share = 0.0
    mean_law: Number | None = None
    sd_log: Number | None = None
    beyond: Number | None = None
    reason: StrictStr | None = None


class MoreTestsEntry(Part):
    """How many more tests decide the target, and how many give the value."""

    tests: Count = 0
    known_to: Number = 0.0
    to_know_the_value: Count | None = None
    to_settle: Count | None = None
    reason: StrictStr | None = None


class SplitEntry(Part):
    """Standard deviations of the logarithm of the value, by where they come from."""

    scatter: Number | None = None
    ignorance: Number | None = None
    numerical: Number | None = None


class BarsEntry(Part):
    """When the bars yield: by the pulse, and under the contact."""

    yield_strength: Number = 0.0
    pulse_stress: Number = 0.0
    pulse_elastic: StrictBool = True
    pulse_value: Number | None = None
    contact_probability: Number = 0.0
    contact: Maybe[Est] = Field(default_factory=Est)
    reason: StrictStr | None = None
    yields_at: dict[ShareKey, Share] = Field(default_factory=dict)
    contact_everywhere: StrictStr | None = None


class ValidityAtEntry(Part):
    """Validity checks at the answer, and the medians of force and energy there."""

    NEEDS = ("value", "samples", "checks")

    value: Number = 0.0
    samples: Count = 0
    checks: tuple[CheckEntry, ...] = ()
    medians: dict[Name, Number] = Field(default_factory=dict)


class MarginEntry(Entry):
    """Values of the free scalar at probabilities of exceeding a limit, the curve, and what the margin is made of."""

    solve: StrictStr
    unit: StrictStr
    values: Quantiles
    curve: Curve
    lognormal: Maybe[LognormalEntry] = Field(default_factory=LognormalEntry)
    family: Maybe[FamilyEntry] = Field(default_factory=FamilyEntry)
    against: Maybe[AgainstEntry] = Field(default_factory=AgainstEntry)
    band: Maybe[BandEntry] = Field(default_factory=BandEntry)
    steps: Maybe[StepsEntry] = Field(default_factory=StepsEntry)
    probability: Number | None = None
    value: Maybe[Est] = Field(default_factory=Est)
    factors: Maybe[FactorsEntry] = Field(default_factory=FactorsEntry)
    lost_to: Maybe[LostEntry] = Field(default_factory=LostEntry)
    ignorance: Maybe[MarginOpenEntry] = Field(default_factory=MarginOpenEntry)
    more_tests: Maybe[MoreTestsEntry] = Field(default_factory=MoreTestsEntry)
    split: Maybe[SplitEntry] = Field(default_factory=SplitEntry)
    bars: Maybe[BarsEntry] = Field(default_factory=BarsEntry)
    validity: Maybe[ValidityAtEntry] = Field(default_factory=ValidityAtEntry)
    also: Ests = Field(default_factory=dict)
