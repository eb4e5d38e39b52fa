"""Every sentence that a report says of a decision, a doubt, a caveat, a check or a run's end.

Results hold values and codes; words are made of them here, for page, terminal, compare and sweep.
"""

import math
import re
from collections.abc import Iterator, Sequence
from itertools import chain

from uqsphere.documents import listed
from uqsphere.mechanics.failure_modes import FAILURE_MODES
from uqsphere.quantities import format_probability, format_share, round_conservative
from uqsphere.results.types import (
    AccuracyEntry,
    Aim,
    Caveat,
    CheckEntry,
    Decision,
    Doubt,
    FreeNumber,
    Kind,
    Range,
    Results,
    Shortfall,
    Stop,
)
from uqsphere.uq import LEVEL_TEXT

from .format import (
    DASH,
    Estimated,
    capital,
    meaning,
    plain_name,
    plain_probability,
    probability,
    small,
    value,
    value_range,
)

#: why a run ended
STOPPED: dict[Stop, str] = {
    "": "running",
    "accurate": "all accuracy targets met",
    "budget": "stopped at the model-run budget",
    "cap": "stopped at the largest sample, two million rows",
    "time": "stopped at the time budget",
    "interrupted": "interrupted by the user",
    "no gain": "stopped: more runs no longer reduce the error",
}
#: how Sobol' indices were estimated
METHODS = {
    "chaos": "from polynomial chaos corrected by model runs",
    "pairs": "from pairs of model runs",
    "": "",
}
NO_LIMIT = "No limit state is defined; the run reports distributions and sensitivities only."


class DecisionText:
    """What a report says of one decision of a run."""

    def __init__(self, results: Results, decision: Decision) -> None:
        self.results, self.decision = results, decision
        self.aim = f"To {decision.aim}"
        self._free = results.study.free
        self._safe_above = bool(decision.safe_above)
        #: the doubt that most failures at the number to use are by, and the one that sets it
        self._governing = [doubt for doubt in decision.doubts if doubt.governs]
        self._setting = [doubt for doubt in decision.doubts if doubt.sets] or self._governing

    def lines(self) -> Iterator[str]:
        """The text of a terminal: one paragraph a line."""
        yield f"{self.aim}: {self.decision.verdict}. {self.use}. {self.sentence}"
        yield self.broken
        if self.open:
            yield f"Open: {'; '.join(self.open)}."
        yield f"Next: {self.next}"

    @property
    def use(self) -> str:
        """The number to use, with its side: "Use at most 0.12 m/s"; or that there is none."""
        free = self._free
        if self.decision.use and free:
            text = f"Use {self._allowed(self.decision.use.value)}"
            if free.path == "pulse.gain":
                return f"{text} times the measured pulse"
            if not free.unit:
                return f"{text} ({free.meaning})"
            return text
        if not free or self.decision.target is None:
            return f"{capital(self._event)} {self.together}"
        if self._kept_everywhere:
            return f"Use any value between {self._ends}"
        return "No value to use"

    @property
    def sentence(self) -> str:
        """The sentence to act on, of at most 45 words: what governs the number, its margin to the
        plan, and what else would be allowed.
        """
        decision = self.decision
        use = decision.use
        if decision.target is None and not use:
            return "No target is set."
        if not self._free:
            return f"{self._target}. Add [margins] for a number to use."
        parts = [self._plan(self._free)]
        used = ""
        if not use:
            parts.insert(0, self._why_none)
        else:
            used = self.number(use.value)
            parts.append(self._governs)
        library = decision.library
        if library and not self._library_governs and self.number(library.weak) != used:
            mode = capital(library.mode)
            parts.append(f"{mode} is assumed{self._library_range}.")
        own = decision.own
        if own and own.margin is not None and self.number(own.margin) != used:
            text = f"By your own limits: {self._allowed(own.margin)}"
            if own.code != "computation":
                text += f" ({_words(own)[1]})"
            parts.append(f"{text}.")
        return " ".join(filter(None, parts))

    @property
    def broken(self) -> str:
        """The probability at the plan: with what governs where that is worse, by all modes and by
        the study's limits; and the target.
        """
        decision = self.decision
        text = capital(self._event)
        if self._free and self._free.planned is not None:
            text += " at the planned value"
        together = self.together
        alone = self._probability(decision.probability)
        text += ": "
        computed = decision.together.value or 0.0
        for doubt in self._setting:
            worst = self._probability(doubt.at_plan)
            worse = _most(doubt.at_plan) > _most(decision.together)
            open_ends = doubt.code not in ("computation", "assumed strength")
            if open_ends and worse and worst != together:
                clause = self._clause(doubt)
                if doubt.subject != decision.governing:
                    clause = f"({plain_name(doubt.subject)}, {clause})"
                text += f"{worst} {clause}; as computed, "
        if not decision.all_modes:
            text += probability(as_event(decision.aim, decision.probability))
        elif together == alone:
            text += f"{alone}, by your own limits and with {all_modes(decision)}"
        else:
            own = decision.own
            sets = [(doubt.subject, doubt.code) for doubt in self._setting]
            text += f"{together} with {all_modes(decision)}; by your own limits {alone}"
            if own and (own.subject, own.code) not in sets:
                # by the doubt that the sentence names
                at_plan = probability_at_target(decision.aim, own.at_plan, own.target)
                if own.code != "computation" and at_plan != alone:
                    text += f", {at_plan} {self._clause(own)}"
        if computed and decision.probability.note:
            text += f", {decision.probability.note}"
        if decision.target is None and not decision.use:
            return f"{text}."
        return f"{text}. {self._target}."

    @property
    def together(self) -> str:
        """The probability at the plan by all that adds up."""
        return self._probability(self.decision.together)

    @property
    def next(self) -> str:
        """What to do about the doubt that governs, and what numbers of tests would buy."""
        decision = self.decision
        remedy = decision.next
        subject = plain_name(remedy.subject)
        if remedy.code == "leave the model's range":
            subject = subject.replace("_", " ")
            for caveat in decision.caveats:
                if re.match("at the (plan and at the )?number to use, ", caveat.text):
                    name = caveat.subject.replace("_", " ")
                    return (
                        f"The number to use lies outside the model's range ({name}): "
                        "test in the machine."
                    )
        if remedy.code == "widen the range" and self._kept_everywhere:
            return "Widen margins.between to find where the target is missed."
        entry = self.results.entries.get(remedy.subject)
        if remedy.code == "change the plan" and entry and not entry.tests:
            return f"Change the planned value or the target, or measure the strength of {subject}."
        tail = "upper" if decision.aim == "break" else "lower"
        strengths = {mode.name: mode.strength.replace("_", " ") for mode in FAILURE_MODES.values()}
        way = ""
        for caveat in decision.caveats:
            if (caveat.code, caveat.subject) == ("rate", remedy.subject):
                way = capital(caveat.text.rpartition(": ")[2])
                if way.startswith("Set"):
                    way += ", or test at the rate of the rig"
        strength = strengths.get(subject, "strength")
        if strength != subject:
            strength += f" ({subject})"
        text = _REMEDIES[remedy.code].format(
            subject=subject,
            tail=tail,
            strength=strength,
            way=way,
        )
        if remedy.gains and self._free:
            gains = []
            for gain in remedy.gains:
                band = value_range(gain.low, gain.high, self._free.quantity)
                band = band.removesuffix(f" {self._free.unit}")
                gains.append(f"{gain.tests} tests: {self.number(gain.median)} ({band})")
            text += f". The number to use would be about (80 % range): {'; '.join(gains)}"
        elif remedy.at_best is not None:
            text += f"; the number to use would then be {self.number(remedy.at_best)} at best"
            if remedy.code == "measure the strength":
                text += f", if {subject} never fails"
        return f"{text}."

    @property
    def open(self) -> list[str]:
        """Why the verdict is not established, and checks that fail."""
        return list(self._reasons())

    # --- parts of these sentences -----------------------------------------------------------------

    def number(self, x: float | None) -> str:
        """A value of the free number, rounded to its conservative side."""
        if x is None or not self._free:
            return "none"
        free = self._free
        return round_conservative(
            x, free.quantity, safe_above=self._safe_above, planned=free.planned
        )[1]

    def span(self, low: float | None, high: float | None) -> str:
        """A range of the free number: its safe end as the number to use, the other as a best
        estimate; a dash without two.
        """
        assert self._free
        first, last = (value(x, self._free.quantity) for x in (low, high))
        if self._safe_above:
            last = self.number(high)
        else:
            first = self.number(low)
        return DASH if first == last else f"{first} to {last}"

    def _probability(self, p: Estimated) -> str:
        """A failure probability as that of the event."""
        decision = self.decision
        return probability_at_target(decision.aim, p, decision.target)

    def _allowed(self, x: float) -> str:
        return f"at {'least' if self._safe_above else 'most'} {self.number(x)}"

    @property
    def _kept_everywhere(self) -> bool:
        """Whether every doubt keeps its target in the whole range."""
        doubts = [doubt for doubt in self.decision.doubts if doubt.code != "assumed strength"]
        notes = {doubt.margin_note for doubt in doubts}
        return notes == {"everywhere"} and not self.decision.blocked_by

    @property
    def _ends(self) -> str:
        """Both ends of the range of the free number."""
        assert self._free
        return " and ".join(
            value(x, self._free.quantity) for x in (self._free.low, self._free.high)
        )

    def _plan(self, free: FreeNumber) -> str:
        """The planned value, and how it stands to the number to use."""
        planned = free.planned
        use = self.decision.use
        if planned is None:
            return ""
        text = f"Planned {free.meaning}: {value(planned, free.quantity)}"
        if use and use.safety_factor is not None:
            codes = {caveat.code for caveat in self.decision.caveats}
            unsafe = codes & {"model range", "criterion range", "rate"}
            if use.safety_factor < 1.0:
                text += ", no margin"
            elif not unsafe:
                text += f", safety factor {use.safety_factor:.3g}"
        return f"{text}."

    @property
    def _governs(self) -> str:
        """What sets the number to use."""
        governing = self.decision.governing
        name = plain_name(governing)
        if governing.startswith("limits."):
            name = f"limit {name}"
        text = f"{capital(name)} governs"
        if self._library_governs:
            return f"{text}, with a strength of the library{self._library_range}."
        for doubt in self._setting:
            clause = self._clause(doubt)
            if doubt.code in ("tests", "computation"):
                end = "upper" if self._safe_above else "lower"
                clause = f"by the {end} end of {clause.removeprefix('with ')}"
            if doubt.subject != governing:
                text += f"; the number is that of {plain_name(doubt.subject)}"
            text += f", {clause}"
        return f"{text}."

    @property
    def _library_governs(self) -> bool:
        """Whether the strength of the library that is told of is that of what governs."""
        library = self.decision.library
        return library is not None and self.decision.governing == f"modes.{library.mode}"

    @property
    def _library_range(self) -> str:
        """What the ends of a strength of the library make of the number; nothing of a strong end
        that leaves it as it is.
        """
        library = self.decision.library
        if not library or (self._library_governs and None in (library.weak, library.strong)):
            return ""
        quantity = self.results.study.modes[library.mode].quantity
        low, high = (value(x, quantity) for x in library.mean_strengths)
        text = f"weak {low}: {self.number(library.weak)}"
        strong = self.number(library.strong)
        if library.strong is not None and not self.use.endswith(f" {strong}"):
            text += f"; strong {high}: {strong}"
        return f" ({text})"

    @property
    def _why_none(self) -> str:
        """Why there is no number to use."""
        decision = self.decision
        if decision.blocked_by:
            name = capital(plain_name(decision.blocked_by))
            allowed = decision.target or 0.0
            if decision.next.code == "mend the model":
                return f"{name} keeps its target only if the model runs that failed keep it."
            if any(point.value is not None and point.value < allowed for point in decision.curve):
                return (
                    f"{name} misses its target at the safe end, or too few model runs tell where "
                    "it keeps it."
                )
            if decision.aim == "break":
                return f"{name} does not reach its target anywhere between {self._ends}."
            return f"{name} exceeds its target everywhere between {self._ends}."
        if not decision.curve:
            margins = self.results.where(f"limits.{decision.limits[0]}", Kind.MARGIN)
            reasons = "; ".join(row.note for row in margins)
            return f"The probability between {self._ends} is not known: {reasons}."
        if self._kept_everywhere:
            return "The target is kept in the whole range."
        return f"The target is not crossed between {self._ends}."

    def _clause(self, doubt: Doubt) -> str:
        """What was considered, in a clause."""
        clause, _ = _words(doubt)
        if doubt.code == "computation" and failed_texts(self.results):
            clause += " and its failed runs"
        return clause

    @property
    def _event(self) -> str:
        """What the probability of the decision is of."""
        return self._event_of(self.decision.governing, self._governing)

    def _event_of(self, subject: str, doubts: Sequence[Doubt]) -> str:
        """What the probability by a limit is of, alone or with what adds up to fracture."""
        entry = self.results.study.limits.get(plain_name(subject))
        if not entry or entry.fracture or any(doubt.joint for doubt in doubts):
            return "fracture probability"
        return "probability of exceedance"

    @property
    def _target(self) -> str:
        target = self.decision.target
        head = "Target:"
        if target is None:
            target = self._setting[0].target
            head = "No target is set; the number to use is for"
        if self.decision.aim == "break":
            return f"{head} at least {format_share(1.0 - target)}"
        return f"{head} at most {format_share(target)}"

    def _reasons(self) -> Iterator[str]:
        decision = self.decision
        grouped: dict[str, list[str]] = {}  # what is said of several limits at once
        for caveat in decision.caveats:
            reason = "the tests of {} are synthetic, not measured"
            word = plain_name(caveat.subject).removesuffix(".strength")
            if caveat.code == "rate":
                head, _, word = caveat.text.rpartition(": ")
                reason = f"{head}: {{}}"
            elif caveat.code != "synthetic tests":
                yield caveat_text(caveat)
                continue
            grouped.setdefault(reason, []).append(word)
        for reason, words in grouped.items():
            yield reason.format(listed(words))
        if decision.verdict == "undecided":
            yield from self._undecided()
        if decision.verdict == "met" and decision.next.code == "measure the strength":
            name = plain_name(decision.next.subject)
            yield (
                f"at the weak end of the library's strength for {name} the planned value misses "
                "the target"
            )
        told = {caveat.subject for caveat in decision.caveats}
        for check in self.results.checks:
            if check.grade == "failure" and check.name not in told:
                effect = f" ({check.effect})" if check.effect else ""
                yield f"check failed: {check.text}{effect}"
        for doubt in decision.doubts:
            if not doubt.counts and (doubt.at_plan.value or 0.0) > doubt.target:
                name = plain_name(doubt.subject)
                p = plain_probability(doubt.at_plan)
                text = (
                    f"damage that is not counted: {name} in {p} of the spheres at the planned value"
                )
                if doubt.margin is not None and self._free:
                    at = value(doubt.margin, self._free.quantity)
                    text += f", in {format_share(doubt.target)} at {at}"
                yield f"{text} (analysis.damage_counts = true counts it)"

    def _undecided(self) -> Iterator[str]:
        """The doubt under which the planned value misses its target by most."""
        aim = self.decision.aim
        doubts = [doubt for doubt in self.decision.doubts if doubt.counts and _most(doubt.at_plan)]
        if doubts:
            worst = max(doubts, key=lambda doubt: _most(doubt.at_plan) / doubt.target)
            p = probability_at_target(aim, worst.at_plan, worst.target)
            if worst.at_plan.value:
                p = f"down to {p}" if aim == "break" else f"up to {p}"
            words = f"({plain_name(worst.subject)}, {self._clause(worst)})"
            event = self._event_of(worst.subject, [worst])
            yield f"{event} at the planned value {p} {words}"


_REMEDIES = {
    "nothing": "The target is met; no further step is needed",
    "set a target": "Set limits.{subject}.target for a verdict",
    "change the plan": (
        "Change the planned value or the target; further measurements cannot change this verdict"
    ),
    "tighten the accuracy": (
        "Run again with a smaller analysis.accuracy.probability or a larger analysis.budget"
    ),
    "widen the range": "Widen margins.between, or change the demand",
    "measure the strength": "Measure the {strength} of this rock",
    "test more": "Make more tests for {subject}",
    "test the lower tail": (
        "Make more tests for {subject}: the {tail} tail of the strength decides"
    ),
    "yielding contacts": 'Let the contacts yield: [contact] law = "plastic"',
    "check the input": "Check {subject}",
    "replace the synthetic tests": "Replace the synthetic tests by measured ones",
    "include the rate": "{way}",
    "mend the model": (
        "Mend the model where its runs fail, or leave such inputs out: what these runs would have "
        "been decides"
    ),
    "leave the model's range": "Choose a plan within the model's range: {subject}",
}


def decision_texts(results: Results) -> list[DecisionText]:
    """The words of every decision of a run."""
    return [DecisionText(results, decision) for decision in results.decisions]


def joint_event(decision: Decision) -> Estimated:
    """The probability of exceedance at the plan, by all failure modes."""
    return as_event(decision.aim, decision.together)


def as_event(aim: Aim, p: Estimated) -> Estimated:
    """A failure probability as that of exceedance: where the aim is to break, the complement; of
    one that is certain but for the last bit, below that bit.

    >>> as_event("break", Range(value=0.25)).value, as_event("survive", Range(value=0.25)).value
    (0.75, 0.25)
    >>> probability(as_event("break", Range(value=1.0)))
    'below 2.3e-14 %'
    """
    if aim == "survive":
        return p
    number, high, low = (None if x is None else 1.0 - x for x in (p.value, p.low, p.high))
    if number == 0.0 and not high:
        high = math.ulp(1.0)
    return Range(value=number, low=low, high=high, note=p.note)


def probability_at_target(aim: Aim, p: Estimated, target: float | None) -> str:
    """A failure probability as that of the event, without its interval; where it reads as its
    target does, with the side that it lies on.

    >>> probability_at_target("survive", Range(value=0.01004), 0.01)
    'just above 1 %'
    """
    event = as_event(aim, p)
    text = plain_probability(event)
    allowed = as_event(aim, Range(value=target)).value
    if event.value is None or allowed is None or text != format_probability(allowed):
        return text
    text = format_share(allowed)
    if math.isclose(p.value or 0.0, target or 0.0, rel_tol=1e-6):
        return text
    side = "above" if event.value > allowed else "below"
    return f"just {side} {text}"


def limit_notes(results: Results) -> Iterator[str]:
    """What is to be known of the table of limits: model runs that failed, strengths that are stated
    without tests or assumed, and damage.
    """
    yield from failed_texts(results)
    entries = results.study.limits.items()
    stated = [name for name, entry in entries if entry.fracture and not entry.tests]
    if stated:
        names = listed(stated)
        yield f"strength without tests, uncertainty not included: {names}"
    if results.study.modes:
        yield "* library strength, not measured on this rock"
    broken = [name for name, entry in entries if entry.aim == "break"]
    if broken:
        yield f"β of not breaking: {listed(broken)}"
    damage = _damage_modes(results.decisions)
    if damage:
        yield f"damage, not counted as fracture: {listed(damage)}"


def failed_texts(results: Results) -> list[str]:
    """What numbers are of where model runs failed; empty elsewhere."""
    return [check_text(check) for check in results.checks if check.name == "failed_rows"]


def all_modes(decision: Decision) -> str:
    """What adds up in a decision: all failure modes, but those that are damage.

    The total may lie below the probability of a mode that is left out.
    """
    damage = _damage_modes([decision])
    if damage:
        return f"all failure modes but {listed(damage)} (damage)"
    return "all failure modes"


def all_together(decision: Decision) -> str:
    """The same in short, beside single modes: what is damage is told elsewhere."""
    damage = _damage_modes([decision])
    if damage:
        return f"all but {listed(damage)}"
    return "all together"


def _damage_modes(decisions: Sequence[Decision]) -> list[str]:
    """Failure modes that damage the sphere and are not counted as its fracture."""
    doubts = chain.from_iterable(decision.doubts for decision in decisions)
    return [*dict.fromkeys(plain_name(doubt.subject) for doubt in doubts if not doubt.counts)]


def _most(p: Range) -> float:
    """A failure probability, or what it is below."""
    return p.value or p.high or 0.0


def _words(doubt: Doubt) -> tuple[str, str]:
    """What was considered, in a clause; and the head of its row in the table of what the number
    rests on.
    """
    distribution = doubt.option.replace("_", " ")
    if distribution == "draws":
        distribution = "posterior"
    elif distribution in ("weibull", "gumbel", "frechet", "rayleigh"):
        distribution = distribution.capitalize()
    family = f"{distribution} distribution"
    plastic = "contacts that yield"
    if doubt.option and doubt.tests:
        plastic += f" and what {doubt.tests} tests leave open ({family})"
    elif doubt.option:
        plastic += f" and a {family} of the strength"
    transferred = f"strength transferred by {meaning(doubt.option)}"
    words = {
        "computation": (
            "with the sampling uncertainty of the run",
            f"as computed ({LEVEL_TEXT} sampling interval)",
        ),
        "tests": (
            f"with what its {doubt.tests} tests leave open",
            f"{doubt.tests} tests, {family}",
        ),
        "distribution": (f"with a {family} of its strength", f"{family} instead"),
        "contact law": (f"with {plastic}", plastic),
        "carrier": (f"with its {transferred}", transferred),
        "tie": (
            "with its strength taken as independent of the inputs",
            "strength independent of the inputs",
        ),
        "assumed strength": (
            "with a strength of the library",
            f"library strength, {doubt.option}".removesuffix(", "),
        ),
    }
    return words[doubt.code]


def doubt_text(doubt: Doubt) -> str:
    """A row's head in the table of what the number rests on."""
    text = _words(doubt)[1]
    if doubt.joint:
        return f"{text}; with the other modes"
    if not doubt.counts:
        return f"{text} (damage, not counted)"
    return text


def evidence_texts(results: Results) -> Iterator[str]:
    """What the study's crushing tests say of strengths of the library."""
    refuted = [entry for entry in results.evidence if entry.refuted]
    raised = [entry for entry in results.evidence if round(entry.raised, 2) > 1.0]
    if refuted:
        names = listed([entry.mode for entry in refuted])
        tests = f"your {refuted[0].tests} tests"
        yield f"Left out, because {tests} refute the library's strength: {names}."
    if raised:
        factors = listed([f"{entry.mode} (weak end times {entry.raised:.3g})" for entry in raised])
        yield f"Library strengths raised to what your tests allow: {factors}."


def caveat_text(caveat: Caveat) -> str:
    """Why a verdict is not established, in a clause."""
    name = plain_name(caveat.subject)
    if caveat.code == "assumed strength":
        return f"{name} rests on a strength of the library, not of this rock"
    if caveat.code == "size" and caveat.value is not None and caveat.bound is not None:
        sizes = [value(x, "sphere.radius") for x in (caveat.value, caveat.bound)]
        return f"the sphere ({sizes[0]}) is not of the tested size ({sizes[1]}, {name})"
    return caveat.text or f"{caveat.code}: {name}"


def check_text(check: CheckEntry) -> str:
    """A check, with its effect."""
    return f"{check.text} – {check.effect}".removesuffix(" – ")


def accuracy_text(accuracy: AccuracyEntry) -> str:
    """How many model runs a run took, why it ended, and the largest error over its tolerance."""
    text = f"{accuracy.runs:,} model runs, {accuracy.seconds:.3g} s; {STOPPED[accuracy.stopped]}"
    if accuracy.reached and accuracy.reached[-1].error is not None:
        text += f" (largest error / tolerance {accuracy.reached[-1].error:.2g})"
    return text


def shortfall_text(shortfall: Shortfall) -> str:
    """An answer that is less accurate than required."""
    what = f"{meaning(shortfall.subject)}, {shortfall.answer.replace('_', ' ')}"
    reached = DASH
    if shortfall.reached is not None:
        reached = f"{shortfall.reached:.2g}"
    return f"{what}: half-width {reached}, required {shortfall.required:.2g}"


def chart_title(results: Results) -> str:
    """What the fragility chart shows."""
    if all(entry.fracture for entry in results.study.limits.values()):
        return "Probability of fracture"
    return "Probability of exceedance"


def exceedance_name(results: Results) -> str:
    """What the probability of a limit is of."""
    return small(chart_title(results).replace("Probability of fracture", "Fracture probability"))
