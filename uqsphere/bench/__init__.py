"""The command `bench`: speed against error on this machine."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from uqsphere.console import answer

__all__ = ["command_bench"]


def command_bench(chosen: argparse.Namespace) -> int:
    """Measure speed against error, or hold the model against published measurements."""
    from uqsphere.bench.measure import run_bench
    from uqsphere.bench.measured import run_measured

    folder = chosen.out or Path("bench-results")
    content = (
        run_measured(folder)
        if chosen.measured
        else run_bench(folder, quick=chosen.quick, notice=lambda text: print(text, file=sys.stderr, flush=True))
    )
    text = content.pop("text")
    return answer(chosen, content, f"{text}\n\nwritten to {folder}")
