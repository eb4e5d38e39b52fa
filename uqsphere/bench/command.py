"""The command `bench`: speed against error, and what else of the evidence is measured from the command line."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from uqsphere.console import print_document as document
from uqsphere.errors import UsageError

__all__ = ["add_bench", "command_bench"]


def add_bench(bench: argparse.ArgumentParser) -> None:
    """The options of the command."""
    bench.add_argument("--quick", action="store_true", help="fewer of everything: a minute instead of ten or more")
    bench.add_argument("--out", type=Path, metavar="DIR", help="where to write (default: bench-results, uq-results)")
    bench.add_argument(
        "--uq",
        nargs="?",
        const="all",
        metavar="PARTS",
        help="the uncertainty engine instead: all, or some of chaos,coverage,given,overhead,granite,rough,studies",
    )
    bench.add_argument("--reliability", type=int, nargs="?", const=10, metavar="N",
                       help="rare-event methods on public problems instead, N runs each (default 10)")  # fmt: skip
    bench.add_argument("--sweep", type=int, metavar="N", help="N hard scenes against a tighter tolerance instead")
    bench.add_argument("--reference", action="store_true", help="with --sweep: against the reference integrator")
    bench.add_argument("--seed", type=int, default=1, help="with --sweep: seed of the scenes (default 1)")
    bench.add_argument("--json", action="store_true", help="print one JSON document on stdout")


def _notice(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def command_bench(chosen: argparse.Namespace) -> int:
    """Measure speed against error, or sweep hard cases."""
    if chosen.sweep is not None:
        return _sweep(chosen)
    if chosen.reliability is not None:
        return _reliability(chosen)
    if chosen.uq is not None:
        from uqsphere.bench.uncertainty import PARTS, run_uncertainty

        folder = chosen.out or Path("uq-results")
        parts = list(PARTS) if chosen.uq == "all" else [name.strip() for name in chosen.uq.split(",")]
        content = run_uncertainty(folder, parts=parts, quick=chosen.quick, notice=_notice)
    else:
        from uqsphere.bench import run_bench

        folder = chosen.out or Path("bench-results")
        content = run_bench(folder, quick=chosen.quick, notice=_notice)
    text = content.pop("text")
    if chosen.json:
        document(content)
    else:
        print(text)
        print(f"\nwritten to {folder}")
    return 0


def _reliability(chosen: argparse.Namespace) -> int:
    from dataclasses import asdict

    from uqsphere.bench.rare import rare_table, rare_text
    from uqsphere.bench.rare_few import few_call_rows, few_call_text

    if not 1 <= chosen.reliability <= 1000:
        raise UsageError(f"--reliability takes 1 to 1,000 runs of each problem, found {chosen.reliability}")
    rows = rare_table(repetitions=chosen.reliability, notice=_notice)
    few = few_call_rows(repetitions=chosen.reliability, notice=_notice)
    if chosen.json:
        document({"reliability": [asdict(row) for row in rows], "few_calls": [asdict(row) for row in few]})
    else:
        print(rare_text(rows))
        print()
        print(few_call_text(few))
    return 0


def _sweep(chosen: argparse.Namespace) -> int:
    from uqsphere.bench.hard_scenes import design
    from uqsphere.bench.sweep import against_itself, against_reference, as_document, table

    if not 1 <= chosen.sweep <= 1_000_000:
        raise UsageError(f"--sweep takes 1 to 1,000,000 scenes, found {chosen.sweep}")
    plan = design(chosen.sweep, chosen.seed)
    found = against_reference(plan, budget=600) if chosen.reference else against_itself(plan)
    if chosen.json:
        document(as_document(found))
    else:
        print(table(found))
    return 0
