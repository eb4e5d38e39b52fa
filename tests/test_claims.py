"""Findings are worded once: what a heading, a line and a paragraph set are parts of one object."""

from __future__ import annotations

from pathlib import Path

import pytest

from uqsphere.report.claims import Claim, claims
from uqsphere.report.terminal import summary_of
from uqsphere.results import read_results

ROOT = Path(__file__).parent.parent


def test_a_claim_is_set_in_parts() -> None:
    claim = Claim(topic="demand", subject="x", head="Limit “x”", body="it holds", more=("by much", "It is known."))
    assert claim.first == "Limit “x”: it holds."
    assert claim.text == "Limit “x”: it holds; by much. It is known."
    assert claim.told == "It holds; by much. It is known."


@pytest.mark.parametrize("name", ["granite", "limestone", "glass-bead"])
def test_a_run_claims_what_it_found_and_nothing_twice(name: str) -> None:
    results = read_results(ROOT / "reports" / name)
    found = claims(results)
    assert len({(claim.topic, claim.subject) for claim in found}) == len(found)
    assert all(claim.text.endswith(".") and ".." not in claim.text for claim in found)
    told = " ".join(summary_of(results, 400).split())
    for claim in found:
        if claim.topic == "answer":
            assert claim.text in told
