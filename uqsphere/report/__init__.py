"""The report of a finished run, and the pictures of one scene over time: all from what is stored."""

from __future__ import annotations

from uqsphere.report.html import build_report
from uqsphere.report.timelines import history_figure, xt_figure

__all__ = ["build_report", "history_figure", "xt_figure"]
