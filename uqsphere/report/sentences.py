"""Every sentence that a report says of a decision, a doubt, a caveat, a check or a run's end.

Results hold values and codes; words are made of them here, for page, terminal, compare and sweep.
"""

import re
from collections.abc import Sequence
from functools import cached_property
from itertools import chain

from uqsphere.mechanics.failure_modes import FAILURE_MODES
from uqsphere.quantities import format_conservative, format_probability, round_conservative
from uqsphere.report.format import (
    DASH,
    capital,
    complement,
    is_least,
    meaning,
    plain_probability,
    probability,
    value,
)
from uqsphere.results.types import (
    AccuracyEntry,
    Caveat,
    CheckEntry,
    Decision,
    Doubt,
    Range,
    Results,
    Shortfall,
    Stop,
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
    """What a report says of one decision.

    aim, verdict : "To survive", and whether it is met
    gains : what a number of tests would buy, as (tests, number to use)
    """

    def __init__(self, results: Results, decision: Decision) -> None:
        self.results, self.decision = results, decision
        self.free = results.study.free
        self.least = is_least(decision)
        self.aim = f"To {decision.aim}"
        self.verdict = decision.verdict
        gains = decision.next.gains
        self.gains = [(f"{gain.tests} tests", self.number(gain.median)) for gain in gains]

    def lines(self) -> list[str]:
        """The text of a terminal: one paragraph a line."""
        lines = [f"{self.aim}: {self.verdict}. {self.use}. {self.sentence}", self.broken]
        if self.open:
            lines.append(f"Open: {'; '.join(self.open)}.")
        lines.append(f"Next: {self.next}")
        if self.gains:
            lines[-1] += " " + "; ".join(f"{tests}: {number}" for tests, number in self.gains) + "."
        return lines

    def number(self, x: float | None) -> str:
        """A value of the free number, rounded to its conservative side."""
        if x is None or self.free is None:
            return "none"
        return format_conservative(x, self.free.path, least=self.least)

    def allowed(self, x: float) -> str:
        return f"at {'least' if self.least else 'most'} {self.number(x)}"

    @cached_property
    def use(self) -> str:
        """The number to use, with its side, "Use at most 0.12 m/s"; or that there is none."""
        if self.decision.use is not None:
            assert self.free is not None
            text = f"Use {self.allowed(self.decision.use.value)}"
            if self.free.path == "pulse.gain":
                return f"{text} times the measured pulse"
            if not self.free.unit:
                return f"{text} ({self.free.meaning})"
            return text
        if self.free is None or self.decision.target is None:
            p = plain_probability(joint_event(self.decision))
            return f"{capital(self.event_name())} {p}"
        if self.kept_everywhere():
            return f"Use any value between {self.ends()}"
        return "No value to use"

    def kept_everywhere(self) -> bool:
        """Whether every doubt keeps its target in the whole range."""
        margins = [doubt for doubt in self.decision.doubts if doubt.code != "assumed strength"]
        return bool(margins) and all(doubt.margin_note == "everywhere" for doubt in margins)

    def ends(self) -> str:
        """Both ends of the range of the free number."""
        assert self.free is not None
        return " and ".join(value(x, self.free.path) for x in (self.free.low, self.free.high))

    @cached_property
    def sentence(self) -> str:
        """The sentence to act on, of at most 45 words: what governs the number, its margin to the
        plan, and what else would be allowed.
        """
        decision = self.decision
        if decision.target is None and decision.use is None:
            return "No target is set."
        if self.free is None:
            return f"{self.target()}. Add [margins] for a number to use."
        used = ""
        if decision.use is None:
            parts = [self.why_none(), self.plan()]
        else:
            used = self.number(decision.use.value)
            parts = [self.plan(), self.governs()]
        if decision.own is not None and self.number(decision.own) != used:
            parts.append(f"By your own limits: {self.allowed(decision.own)}.")
        return " ".join(filter(None, parts))

    def plan(self) -> str:
        """The planned value, and how it stands to the number to use."""
        assert self.free is not None
        planned = self.free.planned
        use = self.decision.use
        if planned is None:
            return ""
        text = f"Planned {self.free.meaning}: {value(planned, self.free.path)}"
        if use is None or use.value <= 0.0 or planned <= 0.0:
            return f"{text}."
        factor = round_conservative(use.value, use.path, least=self.least) / planned
        if self.least:
            factor = 1.0 / factor
        if factor < 1.0:
            return f"{text}, no margin."
        if any(caveat.code in ("model range", "rate") for caveat in self.decision.caveats):
            return f"{text}."
        return f"{text}, safety factor {factor:.3g}."

    def governs(self) -> str:
        """What sets the number to use."""
        library = self.decision.library
        text = f"{capital(plain_name(self.decision.governing))} governs"
        if library is not None:
            text = f"{text}, with a strength of the library"
            if library.weak is None or library.strong is None:
                return f"{text}."
            weak = self.number(library.weak)
            strong = self.number(library.strong)
            return f"{text} (its weak end: {weak}, its strong end: {strong})."
        for doubt in self.decision.doubts:
            if doubt.governs:
                clause = _words(doubt)[0]
                if doubt.code in ("tests", "computation"):
                    end = "upper" if self.least else "lower"
                    clause = f"by the {end} end of {clause.removeprefix('with ')}"
                return f"{text}, {clause}."
        return f"{text}."

    def why_none(self) -> str:
        """Why there is no number to use."""
        if self.decision.blocked_by:
            name = plain_name(self.decision.blocked_by)
            return f"{capital(name)} exceeds its target everywhere between {self.ends()}."
        if self.kept_everywhere():
            return "The target is kept in the whole range."
        return f"The target is not crossed between {self.ends()}."

    def event_name(self) -> str:
        """What the probability of the decision is of."""
        governing = self.decision.governing
        entry = self.results.study.limits.get(plain_name(governing))
        joint = any(doubt.joint for doubt in self.decision.doubts if doubt.governs)
        if entry is None or entry.fracture or joint or governing.startswith("modes."):
            return "fracture probability"
        return "probability of exceedance"

    @cached_property
    def broken(self) -> str:
        """The probability at the plan: by what governs where that is worse, by all modes and by
        the study's limits; and the target.
        """
        decision = self.decision
        text = capital(self.event_name())
        if self.free is not None and self.free.planned is not None:
            text += " at the planned value"
        by_study = as_event(decision, decision.probability)
        together = plain_probability(joint_event(decision))
        alone = plain_probability(by_study)
        text += ": "
        computed = (decision.all_modes or decision.probability).value or 0.0
        for doubt in decision.doubts:
            governing = plain_probability(as_event(decision, doubt.at_plan))
            worse = (doubt.at_plan.value or 0.0) > computed
            open_ends = doubt.code not in ("computation", "assumed strength")
            if doubt.governs and open_ends and worse and governing != together:
                text += f"{governing} by what governs; as computed, "
        if decision.all_modes is None:
            text += probability(by_study)
        elif together == alone:
            text += f"{alone}, by your own limits and with {all_modes(decision)}"
        else:
            text += f"{together} with {all_modes(decision)}, {alone} by your own limits"
        if decision.target is None:
            return f"{text}."
        return f"{text}. {self.target()}."

    def target(self) -> str:
        target = self.decision.target
        if target is None:
            return "No target is set"
        if self.decision.aim == "break":
            return f"Target: at least {format_probability(1.0 - target)}"
        return f"Target: at most {format_probability(target)}"

    @cached_property
    def next(self) -> str:
        """What to do about the doubt that governs."""
        remedy = self.decision.next
        subject = plain_name(remedy.subject)
        if remedy.code == "leave the model's range":
            subject = subject.replace("_", " ")
            for caveat in self.decision.caveats:
                at_number = "at the number to use, " in caveat.text.partition(":")[0]
                if caveat.code == "model range" and at_number and ", not at" not in caveat.text:
                    name = caveat.subject.replace("_", " ")
                    return (
                        f"The number to use lies outside the model's range ({name}): "
                        "test in the machine."
                    )
        if remedy.code == "widen the range" and self.kept_everywhere():
            return "Widen margins.between to find where the target is missed."
        tail = "upper" if self.decision.aim == "break" else "lower"
        text = _REMEDIES[remedy.code].format(subject=subject, tail=tail)
        if remedy.code == "measure the strength":
            text = f"Measure the {_strength_name(self.results, remedy.subject)} of this rock"
        if remedy.gains:
            return f"{text}. The number to use would be about:"
        if remedy.at_best is not None:
            best = self.number(remedy.at_best)
            condition = ""
            if remedy.code == "measure the strength":
                condition = f", if {subject} never fails"
            return f"{text}; the number to use would then be {best} at best{condition}."
        return f"{text}."

    @cached_property
    def open(self) -> list[str]:
        """Why a verdict is not established, and checks that fail."""
        decision = self.decision
        texts = []
        synthetic = []
        for caveat in decision.caveats:
            if caveat.code == "synthetic tests":
                synthetic.append(plain_name(caveat.subject).removesuffix(".strength"))
            else:
                texts.append(caveat_text(caveat))
        if synthetic:
            texts.append(f"the tests of {listed(synthetic)} are synthetic, not measured")
        if decision.verdict == "undecided":
            texts += _undecided(decision)
        told = {caveat.subject for caveat in decision.caveats}
        for check in self.results.checks:
            if check.grade == "failure" and check.name not in told:
                effect = f" ({check.effect})" if check.effect else ""
                texts.append(f"check failed: {check.text}{effect}")
        for doubt in decision.doubts:
            if not doubt.counts and (doubt.at_plan.value or 0.0) > doubt.target:
                name = plain_name(doubt.subject)
                p = plain_probability(doubt.at_plan)
                text = (
                    f"damage that is not counted: {name} in {p} of the spheres at the planned value"
                )
                if doubt.margin is not None and self.free is not None:
                    at = value(doubt.margin, self.free.path)
                    text += f", in {format_probability(doubt.target)} at {at}"
                texts.append(f"{text} (analysis.damage_counts = true counts it)")
        return texts


def decision_texts(results: Results) -> list[DecisionText]:
    """The words of every decision of a run."""
    return [DecisionText(results, decision) for decision in results.decisions]


_REMEDIES = {
    "nothing": "The target is met; no further step is needed",
    "set a target": "Set limits.{subject}.target for a verdict",
    "change the plan": (
        "Change the planned value or the target; further measurements cannot change this verdict"
    ),
    "tighten the accuracy": "Run again with a smaller analysis.accuracy.probability",
    "widen the range": "Widen margins.between, or reduce the demand",
    "measure the strength": "Measure the strength of this rock in {subject}",
    "test more": "Test more spheres for {subject}",
    "test the lower tail": (
        "Test more spheres for {subject}: the {tail} tail of the strength decides"
    ),
    "yielding contacts": 'Let the contacts yield: [contact] law = "plastic"',
    "check the input": "Check {subject}",
    "replace the synthetic tests": "Replace the synthetic tests by measured ones",
    "include the rate": "Give {subject} at the strain rate of the rig: rate_0, or dynamic tests",
    "leave the model's range": "Choose a plan within the model's range: {subject}",
}


def _undecided(decision: Decision) -> list[str]:
    """The doubt under which the planned value misses its target by most."""
    doubts = [doubt for doubt in decision.doubts if doubt.counts and doubt.at_plan.value]
    if not doubts:
        return []
    worst = max(doubts, key=lambda doubt: (doubt.at_plan.value or 0.0) / doubt.target)
    p = plain_probability(as_event(decision, worst.at_plan))
    name = plain_name(worst.subject)
    side = "down to" if decision.aim == "break" else "up to"
    return [f"fracture probability at the planned value {side} {p} ({name}, {_words(worst)[0]})"]


def limit_notes(results: Results) -> list[str]:
    """What is to be known of the strengths in the table of limits: stated without tests, assumed,
    and damage.
    """
    notes = []
    entries = results.study.limits.items()
    stated = [name for name, entry in entries if entry.fracture and not entry.tests]
    if stated:
        names = listed(stated)
        notes.append(f"strength stated without tests, its uncertainty in no range here: {names}")
    if results.study.modes:
        notes.append("* assumed: library strength, not measured on this rock")
    damage = damage_modes(results.decisions)
    if damage:
        notes.append(f"damage, not counted as fracture: {listed(damage)}")
    return notes


def all_modes(decision: Decision) -> str:
    """What adds up in a decision: all failure modes, but those that are damage.

    The total may lie below the probability of a mode that is left out.
    """
    damage = damage_modes([decision])
    if damage:
        return f"all but {listed(damage)} (damage)"
    return "all failure modes"


def listed(words: Sequence[str]) -> str:
    """Words as a list in a sentence.

    >>> listed(["a", "b", "c"]), listed(["a"])
    ('a, b and c', 'a')
    """
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} and {words[-1]}"


def joint_event(decision: Decision) -> Range:
    """The probability of exceedance at the plan, by all failure modes."""
    return as_event(decision, decision.all_modes or decision.probability)


def as_event(decision: Decision, p: Range) -> Range:
    """A failure probability as that of exceedance: where the aim is to break, the complement."""
    if decision.aim == "break":
        return complement(p)
    return p


def plain_name(subject: str) -> str:
    """A limit or failure mode by its own name.

    >>> plain_name("modes.core tension"), plain_name("")
    ('core tension', 'all failure modes together')
    """
    return re.sub(r"^(limits|modes)\.", "", subject) or "all failure modes together"


def _strength_name(results: Results, subject: str) -> str:
    """The property that a strength of the library is: "fracture toughness"."""
    name = plain_name(subject)
    entry = results.study.modes.get(name)
    mode_name = entry.mode if entry else name
    strengths = {mode.name: mode.strength.replace("_", " ") for mode in FAILURE_MODES.values()}
    return f"{strengths.get(mode_name, 'strength')} ({name})"


def _words(doubt: Doubt) -> tuple[str, str]:
    """What was considered, in a clause; and the head of its row in the table of what the number
    rests on.
    """
    family = f"{_family(doubt.option)} distribution"
    plastic = f"contacts that yield{_further_assumption(doubt)}"
    transferred = f"strength transferred by {meaning(doubt.option)}"
    words = {
        "computation": (
            "with the sampling uncertainty of the run",
            "as computed (95 % sampling interval)",
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


def damage_modes(decisions: Sequence[Decision]) -> list[str]:
    """Failure modes that damage the sphere and are not counted as its fracture."""
    doubts = chain.from_iterable(decision.doubts for decision in decisions)
    return list(dict.fromkeys(plain_name(doubt.subject) for doubt in doubts if not doubt.counts))


def _family(option: str) -> str:
    """A distribution by its name: "Weibull", "lognormal"."""
    if option == "draws":
        return "posterior"
    text = option.replace("_", " ")
    if text in ("weibull", "gumbel", "frechet", "rayleigh"):
        return text.capitalize()
    return text


def _further_assumption(doubt: Doubt) -> str:
    """What is considered of the strength where contacts yield."""
    if not doubt.option:
        return ""
    if doubt.tests:
        return f" and what {doubt.tests} tests leave open ({_family(doubt.option)} distribution)"
    return f" and a {_family(doubt.option)} distribution of the strength"


def evidence_texts(results: Results) -> list[str]:
    """What the study's crushing tests say of strengths of the library."""
    refuted = [entry for entry in results.evidence if entry.refuted]
    raised = [entry for entry in results.evidence if not entry.refuted and entry.raised > 1.0]
    texts = []
    if refuted:
        names = listed([entry.mode for entry in refuted])
        tests = f"your {refuted[0].tests} tests"
        texts.append(f"Left out, because {tests} refute the library's strength: {names}.")
    if raised:
        factors = listed([f"{entry.mode} (weak end times {entry.raised:.2g})" for entry in raised])
        texts.append(f"Library strengths raised to what your tests allow: {factors}.")
    return texts


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
    if any(entry.fracture for entry in results.study.limits.values()):
        return "Probability of fracture"
    return "Probability of exceedance"


def exceedance_name(results: Results) -> str:
    """What the probability of a limit is of: "fracture probability"."""
    return chart_title(results).lower().replace("probability of fracture", "fracture probability")
