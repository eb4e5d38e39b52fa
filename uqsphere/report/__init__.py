"""The report of a finished run, and the pictures of one scene over time: all from what is stored."""

from __future__ import annotations

from uqsphere.report.figures.history import history_figure, xt_figure
from uqsphere.report.page import build_report

__all__ = ["build_report", "history_figure", "xt_figure"]
