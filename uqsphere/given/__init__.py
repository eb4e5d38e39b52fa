"""What a table of runs that were made already can tell: laws of the inputs, dependence, outputs, what drives them."""

from __future__ import annotations

from uqsphere.given.analysis import Data, analyse_runs, known_laws, read_data

__all__ = ["Data", "analyse_runs", "known_laws", "read_data"]
