"""Sentences of a decision, on decisions made by hand: values and codes in, words out."""

import math
from pathlib import Path

import pytest

from uqsphere.quantities import round_conservative
from uqsphere.report import summary
from uqsphere.report.sentences import (
    STOPPED,
    DecisionText,
    all_modes,
    doubt_text,
    exceedance_name,
    probability_at_target,
)
from uqsphere.report.tables import certificate, indices, limits
from uqsphere.results.types import (
    Caveat,
    CheckEntry,
    Decision,
    DependenceEntry,
    Doubt,
    LibraryRange,
    Range,
    Remedy,
    Results,
    Use,
)

GRANITE = Path(__file__).parents[2] / "reports" / "granite" / "results.json"


@pytest.fixture(scope="module")
def granite() -> Results:
    return Results.model_validate_json(GRANITE.read_bytes())


def used(value: float, *, least: bool = False, planned: float = 0.5) -> Use:
    rounded, _ = round_conservative(value, "striker.speed", safe_above=least, planned=planned)
    return Use(
        path="striker.speed",
        value=value,
        safe_end="smallest" if least else "largest",
        planned=planned,
        safety_factor=planned / rounded if least else rounded / planned,
        best=Range(value=value),
    )


def decision(**changes: object) -> Decision:
    values = {
        "aim": "survive",
        "limits": ["crushing"],
        "verdict": "met",
        "target": 0.01,
        "governing": "limits.crushing",
        "use": used(0.653),
        "probability": Range(value=0.002, low=0.0019, high=0.0021),
        "next": Remedy(code="nothing"),
        **changes,
    }
    return Decision.model_validate(values)


def test_the_sentence_has_number_plan_and_what_governs(granite: Results) -> None:
    doubt = Doubt(
        code="tests",
        subject="limits.crushing",
        option="weibull",
        target=0.01,
        margin=0.653,
        governs=True,
        tests=20,
    )
    text = DecisionText(granite, decision(doubts=[doubt]))
    assert text.use == "Use at most 0.65 m/s"
    assert text.sentence == (
        "Planned striker speed: 0.5 m/s, safety factor 1.3. "
        "Limit crushing governs, by the lower end of what its 20 tests leave open."
    )
    assert text.broken.endswith("0.200 % (0.190 to 0.210 %). Target: at most 1 %.")
    assert doubt_text(doubt) == "20 tests, Weibull distribution"


def test_the_probability_by_what_governs_comes_first(granite: Results) -> None:
    """The smaller one as computed is not the one to sign."""
    doubt = Doubt(
        code="tests",
        subject="limits.crushing",
        option="weibull",
        target=0.01,
        margin=0.653,
        at_plan=Range(value=0.024),
        governs=True,
        joint=True,
        tests=20,
    )
    text = DecisionText(granite, decision(doubts=[doubt], all_modes=Range(value=0.002)))
    assert text.broken == (
        "Fracture probability at the planned value: 2.4 % with what its 20 tests leave open; as "
        "computed, 0.2 %, by your own limits and with all failure modes. Target: at most 1 %."
    )
    assert doubt_text(doubt).endswith("; with the other modes")
    text = DecisionText(granite, decision(doubts=[doubt.model_copy(update={"sets": True})]))
    assert ": 2.4 % with what its 20 tests leave open; as computed" in text.broken
    core = Doubt(code="computation", subject="limits.core", target=0.01, margin=0.66, governs=True)
    sets = doubt.model_copy(update={"governs": False, "sets": True})
    text = DecisionText(granite, decision(doubts=[core, sets], governing="limits.core"))
    assert ": 2.4 % (crushing, with what its 20 tests leave open); as computed" in text.broken
    for change in ({"code": "computation"}, {"at_plan": Range(value=0.001)}):
        milder = DecisionText(granite, decision(doubts=[doubt.model_copy(update=change)]))
        assert "leave open" not in milder.broken


def test_a_strength_of_the_library_that_governs_gives_three_numbers(granite: Results) -> None:
    library = LibraryRange(
        mode="core tension",
        weak=0.064,
        strong=0.27,
        mean_strengths=(5e6, 15e6),
    )
    own = Doubt(
        code="tie",
        subject="limits.crushing",
        target=0.01,
        margin=0.65,
        at_plan=Range(value=0.008),
    )
    text = DecisionText(
        granite,
        decision(
            governing="modes.core tension",
            verdict="not established",
            use=used(0.122),
            own=own,
            all_modes=Range(value=0.97),
            library=library,
            caveats=[Caveat(code="assumed strength", subject="modes.core tension")],
            next=Remedy(code="measure the strength", subject="modes.core tension", at_best=0.42),
        ),
    )
    assert text.use == "Use at most 0.12 m/s"
    assert "no margin" in text.sentence
    assert "(weak 5 MPa: 0.064 m/s; strong 15 MPa: 0.27 m/s)" in text.sentence
    assert "By your own limits: at most 0.65 m/s (strength independent of the inputs)." in (
        text.sentence
    )
    assert (
        "97 % with all failure modes; by your own limits 0.2 %, 0.8 % with its strength taken as "
        "independent of the inputs. " in text.broken
    )
    assert len(f"{text.use}. {text.sentence}".split()) <= 45
    assert text.open == ["core tension rests on a strength of the library, not of this rock"]
    assert text.next.startswith("Measure the tensile strength (core tension)")
    assert text.next.endswith("would then be 0.42 m/s at best, if core tension never fails.")


def test_damage_over_the_target_is_told_though_it_does_not_count(granite: Results) -> None:
    rows = [
        Doubt(
            code="assumed strength",
            subject="modes.ring crack",
            target=0.01,
            margin=0.2,
            at_plan=Range(value=p),
            counts=counts,
        )
        for p, counts in ((0.91, False), (0.002, False), (0.91, True))
    ]
    told = [DecisionText(granite, decision(doubts=[row])).open for row in rows]
    assert told == [
        [
            "damage that is not counted: ring crack in 91 % of the spheres at the planned value, "
            "in 1 % at 0.2 m/s (analysis.damage_counts = true counts it)"
        ],
        [],
        [],
    ]


def test_a_total_says_what_it_leaves_out(granite: Results) -> None:
    row = {
        "code": "assumed strength",
        "subject": "modes.ring crack",
        "target": 0.01,
        "margin": None,
    }
    judged = decision(
        doubts=[Doubt(**row, counts=False)], all_modes=Range(value=0.34), probability=Range(value=0)
    )
    assert all_modes(judged) == "all failure modes but ring crack (damage)"
    assert (
        "34 % with all failure modes but ring crack (damage)"
        in DecisionText(granite, judged).broken
    )
    assert all_modes(decision()) == "all failure modes"


def test_a_number_to_use_without_a_unit_says_what_it_is_of(granite: Results) -> None:
    assert granite.study.free is not None
    texts = []
    for path, meaning in (("pulse.gain", "gain"), ("sphere.nu", "Poisson ratio")):
        free = {"path": path, "quantity": path, "meaning": meaning, "unit": ""}
        free = granite.study.free.model_copy(update=free)
        study = granite.study.model_copy(update={"free": free})
        results = granite.model_copy(update={"study": study})
        texts.append(DecisionText(results, decision(use=used(0.36))).use)
    assert texts == [
        "Use at most 0.36 times the measured pulse",
        "Use at most 0.36 (Poisson ratio)",
    ]


@pytest.mark.parametrize(
    ("where", "said"),
    [
        ("at the plan, not at the number to use, ", "Choose a plan within the model's range"),
        ("at the number to use, ", "The number to use lies outside the model's range"),
        ("at the plan and at the number to use, ", "The number to use lies outside"),
    ],
)
def test_a_number_outside_the_model_is_told(granite: Results, where: str, said: str) -> None:
    caveat = Caveat(code="model range", subject="small_contact", text=f"{where}all samples: a/r")
    remedy = Remedy(code="leave the model's range", subject="small_contact")
    text = DecisionText(granite, decision(caveats=[caveat], next=remedy))
    assert text.next.startswith(said)
    assert "safety factor" not in text.sentence


def test_both_clauses_of_a_decision_to_break_say_how_many_break(granite: Results) -> None:
    text = DecisionText(
        granite,
        decision(
            aim="break",
            target=0.05,
            use=used(0.213, least=True),
            safe_above=True,
            probability=Range(value=0.0, low=0.0, high=7.32e-4),
        ),
    )
    assert text.use == "Use at least 0.22 m/s"
    assert "safety factor 2.27" in text.sentence
    assert "above 99.92" in text.broken
    assert "Target: at least 95 %." in text.broken


def test_a_probability_of_which_nothing_was_seen_is_below_its_bound(granite: Results) -> None:
    text = DecisionText(granite, decision(probability=Range(value=0.0, low=0.0, high=7.32e-4)))
    assert "below 0.074 %" in text.broken
    assert " 0 %" not in text.broken


def test_what_a_number_of_tests_buys_is_told(granite: Results) -> None:
    gains = [
        {"tests": n, "low": x - 0.1, "median": x, "high": x + 0.1}
        for n, x in ((25, 0.75), (100, 0.85))
    ]
    remedy = Remedy.model_validate(
        {"code": "test more", "subject": "limits.crushing", "gains": gains}
    )
    text = DecisionText(granite, decision(next=remedy))
    assert text.next.endswith(
        "would be about (80 % range): 25 tests: 0.75 m/s (0.650 to 0.850); 100 tests: 0.85 m/s "
        "(0.750 to 0.950)."
    )


def test_no_number_says_by_which_limit(granite: Results) -> None:
    own = Doubt(code="computation", subject="limits.crushing", target=0.01, margin=0.65)
    text = DecisionText(granite, decision(use=None, blocked_by="modes.ring crack", own=own))
    assert text.use == "No value to use"
    assert "Ring crack exceeds its target everywhere between 50 mm/s" in text.sentence or (
        "Ring crack exceeds its target everywhere between 0.05 m/s and" in text.sentence
    )
    assert "By your own limits: at most 0.65 m/s." in text.sentence


def test_limits_that_lack_the_rate_of_the_rig_are_one_clause(granite: Results) -> None:
    caveats = [
        Caveat(code="rate", subject=f"limits.{name}", text=f"slow tests: set limits.{name}.rate_0")
        for name in ("force", "energy")
    ]
    text = DecisionText(granite, decision(caveats=caveats))
    assert text.open == ["slow tests: set limits.force.rate_0 and set limits.energy.rate_0"]
    remedy = Remedy(code="include the rate", subject="limits.energy")
    caveats.append(Caveat(code="synthetic tests", subject="limits.energy"))
    text = DecisionText(granite, decision(caveats=caveats, next=remedy))
    assert text.next == "Set limits.energy.rate_0, or test at the rate of the rig."
    study = granite.study.model_copy(update={"free": None})
    fixed = granite.model_copy(update={"study": study})
    text = DecisionText(fixed, decision(use=None, caveats=caveats))
    assert text.sentence == "Target: at most 1 %. Add [margins] for a number to use."


#: a doubt that keeps its target in the whole range
EVERYWHERE = {
    "code": "tests",
    "subject": "limits.crushing",
    "target": 0.05,
    "margin": None,
    "margin_note": "everywhere",
}


def test_what_tests_leave_open_is_told_where_it_is_more_than_a_bound(granite: Results) -> None:
    """No failure was seen among 4,096 rows: what tests leave open below that bound is in it."""
    doubt = Doubt(**EVERYWHERE | {"margin_note": "", "tests": 20, "governs": True})
    for at_plan, told in ((8e-6, False), (2e-3, True)):
        open_end = doubt.model_copy(update={"at_plan": Range(value=at_plan)})
        seen = Range(value=0.0, low=0.0, high=7.3e-4)
        text = DecisionText(granite, decision(doubts=[open_end], probability=seen))
        assert ("leave open" in text.broken) is told
        assert "below 0.073 %" in text.broken


def test_a_verdict_that_a_bound_leaves_undecided_says_so(granite: Results) -> None:
    at_plan = Range(value=0.0, high=7.3e-4)
    doubt = Doubt(**EVERYWHERE | {"code": "computation", "target": 1e-4, "at_plan": at_plan})
    undecided = decision(verdict="undecided", target=1e-4, doubts=[doubt])
    (line,) = DecisionText(granite, undecided).open
    assert line.startswith("fracture probability at the planned value below 0.073 % (crushing,")


def test_synthetic_tests_of_several_limits_are_one_clause(granite: Results) -> None:
    caveats = [
        Caveat(code="synthetic tests", subject=f"{name}.strength") for name in ("force", "energy")
    ]
    text = DecisionText(granite, decision(caveats=caveats))
    assert text.open == ["the tests of force and energy are synthetic, not measured"]


def test_a_check_that_fails_stands_beside_the_number(granite: Results) -> None:
    failed = CheckEntry(name="contact_size", text="a/r is 1.6", share=1.0, grade="failure")
    results = granite.model_copy(update={"checks": [failed], "decisions": [decision()]})
    assert DecisionText(results, decision()).open == ["check failed: a/r is 1.6"]
    assert "check failed: a/r is 1.6" in summary(results)
    known = decision(caveats=[Caveat(code="model range", subject="contact_size", text="a/r")])
    assert DecisionText(results, known).open == ["a/r"]


def test_the_terminal_has_no_codes(granite: Results) -> None:
    for code, words in STOPPED.items():
        accuracy = granite.accuracy.model_copy(update={"stopped": code})
        text = summary(granite.model_copy(update={"accuracy": accuracy}))
        assert words in text.replace("\n", " ")
        assert f"({code})" not in text
        assert len(text.splitlines()) <= 40


def test_a_row_has_the_conservative_end_of_its_doubts(granite: Results) -> None:
    ends = {"subject": "limits.crushing", "target": 0.01}
    doubts = [
        Doubt(code="computation", margin=0.66, **ends),
        Doubt(code="tests", margin=0.404, tests=20, **ends),
    ]
    use = used(0.404).model_copy(update={"best": Range(value=0.66, low=0.404, high=0.661)})
    judged = decision(doubts=doubts, use=use)
    results = granite.model_copy(update={"decisions": [judged]})
    table = limits(results)
    assert table is not None
    # other modes are judged with it: they have one number together
    assert table.rows[0][4:6] == ("", "")
    alone = results.model_copy(update={"study": results.study.model_copy(update={"modes": {}})})
    table = limits(alone)
    assert table is not None
    assert table.rows[0][4:6] == ("0.4 m/s", "0.4 m/s to 0.661 m/s")
    # none, though each doubt has a margin: the plan contradicts the curve
    none = judged.model_copy(update={"use": None})
    table = limits(alone.model_copy(update={"decisions": [none]}))
    assert table.rows[0][4:6] == ("–", "–")


def test_the_tail_that_decides_is_the_upper_one_to_break(granite: Results) -> None:
    remedy = Remedy(code="test the lower tail", subject="limits.crushing", at_best=0.42)
    survives = DecisionText(granite, decision(next=remedy)).next
    breaks = DecisionText(granite, decision(aim="break", next=remedy)).next
    assert "the lower tail of the strength decides" in survives
    assert "the upper tail of the strength decides" in breaks
    assert survives.endswith("; the number to use would then be 0.42 m/s at best.")


def test_a_failure_mode_that_is_damage_is_named_below_the_table(granite: Results) -> None:
    doubt = Doubt(
        code="assumed strength", subject="modes.ring crack", counts=False, target=0.01, margin=0.18
    )
    damaged = granite.model_copy(update={"decisions": [decision(doubts=[doubt])]})
    text = summary(damaged).replace("\n", " ")
    assert "damage, not counted as fracture: ring crack" in text


def test_draws_of_a_fit_are_a_posterior_distribution() -> None:
    doubt = Doubt(code="tests", subject="limits.a", option="draws", target=0.1, margin=1, tests=36)
    assert doubt_text(doubt) == "36 tests, posterior distribution"


def test_tied_inputs_are_the_reason_for_no_indices(granite: Results) -> None:
    tie = DependenceEntry(of=["sphere.nu", "sphere.E"], text="Spearman's rank correlation -0.6")
    study = granite.study.model_copy(update={"dependence": [tie]})
    sobol = [row for row in granite.answers if row.answer.startswith("sobol")]
    for rows in (
        [row for row in granite.answers if row not in sobol],
        [
            row if row not in sobol else row.model_copy(update={"value": None})
            for row in granite.answers
        ],
    ):
        results = granite.model_copy(update={"study": study, "answers": rows})
        assert "tied inputs" in indices(results).rows[0][0]
        assert "tied inputs" in summary(results)


def test_a_probability_that_reads_as_its_target_tells_its_side(granite: Results) -> None:
    assert probability_at_target("survive", Range(value=0.01004), 0.01) == "just above 1 %"
    assert probability_at_target("survive", Range(value=0.00996), 0.01) == "just below 1 %"
    assert probability_at_target("break", Range(value=0.0502), 0.05) == "just below 95 %"
    assert probability_at_target("survive", Range(value=0.01), 0.01) == "1 %"
    text = DecisionText(granite, decision(all_modes=Range(value=0.01003))).broken
    assert "just above 1 % with all failure modes" in text


def test_numbers_of_the_certificate_are_rounded_as_the_one_to_use(granite: Results) -> None:
    (row,) = [row for row in granite.decisions[0].doubts if row.governs]
    shown = [cells[1] for cells in certificate(granite, granite.decisions[0]).rows]
    number = DecisionText(granite, granite.decisions[0]).number(row.margin)
    assert f"Use at most {number}" == DecisionText(granite, granite.decisions[0]).use
    assert number in shown


def test_a_decision_without_a_free_number_has_its_certificate(granite: Results) -> None:
    study = granite.study.model_copy(update={"free": None})
    table = certificate(granite.model_copy(update={"study": study}), granite.decisions[0])
    assert {len(cells) for cells in table.rows} == {len(table.head)} == {2}


def test_a_curve_that_turns_back_is_not_outside_the_range(granite: Results) -> None:
    rows = []
    for row in granite.answers:
        if row.subject == "limits.crushing" and row.answer == "margin":
            row = row.model_copy(update={"value": None})
        if row.subject == "limits.crushing" and row.answer == "curve":
            far = math.log(float(row.at) / 0.5) ** 2
            row = row.model_copy(update={"value": min(far, 1.0)})
        rows.append(row)
    table = limits(granite.model_copy(update={"answers": rows}))
    assert table.rows[0][3] == "several values"


def test_a_target_is_told_as_it_was_asked(granite: Results) -> None:
    text = DecisionText(granite, decision(aim="break", target=1e-6, probability=Range(value=2e-6)))
    assert text.broken.endswith("99.9998 %. Target: at least 99.9999 %.")
    assert DecisionText(granite, decision(target=0.0123)).broken.endswith("at most 1.23 %.")
    assert probability_at_target("survive", Range(value=0.01215), 0.0123) == "just below 1.23 %"
    assert probability_at_target("break", Range(value=2.004e-6), 2e-6) == "just below 99.9998 %"


def test_a_limit_that_breaks_nothing_has_a_probability_of_exceedance(granite: Results) -> None:
    entry = granite.study.limits["crushing"].model_copy(update={"fracture": False})
    study = granite.study.model_copy(update={"limits": {"crushing": entry}})
    doubts = [
        Doubt(
            code="computation",
            subject="limits.crushing",
            target=0.01,
            margin=0.5,
            at_plan=Range(value=0.02),
            governs=True,
        )
    ]
    undecided = decision(verdict="undecided", doubts=doubts)
    for results, event in ((granite, "fracture probability"), (None, "probability of exceedance")):
        results = results or granite.model_copy(update={"study": study})
        (text,) = DecisionText(results, undecided).open
        assert text.startswith(f"{event} at the planned value up to 2 %")
        assert exceedance_name(results) == event


def test_too_few_rows_are_not_a_target_that_is_missed(granite: Results) -> None:
    doubt = Doubt(
        code="computation",
        subject="limits.crushing",
        target=0.01,
        margin=None,
        margin_note="too few rows",
    )
    judged = decision(use=None, blocked_by="limits.crushing", doubts=[doubt])
    assert certificate(granite, judged).rows[0][1] == "not known"
    study = granite.study.model_copy(update={"modes": {}})
    alone = granite.model_copy(update={"study": study, "decisions": [judged]})
    assert limits(alone).rows[0][4:6] == ("not known", "–")
