"""Answers that are vectors: the band of a field, and how much of its variance each input makes, place by place."""

from __future__ import annotations

from typing import Final

import numpy as np

from uqsphere.report.figures.canvas import BLUE, Picture, legend_above, new_figure, slug, style
from uqsphere.report.phrases import short_input
from uqsphere.results.fields import Stored

#: length of an interval of an index above which it is not drawn
_TOLD: Final = 0.5


def field_figure(name: str, stored: Stored, *, over_time: bool) -> Picture:
    """The band above, with the intervals of its ends; below it the total index of the inputs that matter most."""
    answer, places = stored.answer, stored.places * (1e6 if over_time else 1.0)
    with style():
        figure, axes = new_figure(5.0 if stored.inputs else 3.2, rows=2 if stored.inputs else 1, sharex=True)
        band = axes[0]
        for k, level in enumerate(answer.levels):
            ends = answer.quantiles
            band.fill_between(places, ends.low[k], ends.high[k], color=BLUE, alpha=0.35, linewidth=0.0)
            middle = level == 0.5
            band.plot(places, ends.value[k], color=BLUE, linewidth=1.4 if middle else 0.7, label=f"{100.0 * level:g} %")
        band.set_ylabel("force [N]" if over_time else name)
        legend_above(band, len(answer.levels))
        if stored.inputs:
            total = answer.total
            largest = np.argsort(-np.nan_to_num(total.value).mean(axis=1))[:5]
            for j in largest.tolist():
                # an interval over half of the axis tells nothing
                known = total.high[j] - total.low[j] < _TOLD
                value = np.where(known, total.value[j], np.nan)
                (line,) = axes[1].plot(places, value, label=short_input(stored.inputs[j]))
                axes[1].fill_between(places, total.low[j], total.high[j], where=known, color=line.get_color(),
                                     alpha=0.25, linewidth=0.0)  # fmt: skip
            axes[1].set_ylim(0.0, 1.0)
            axes[1].set_ylabel("total index")
            legend_above(axes[1], 2)
        axes[-1].set_xlabel("time since first touch [µs]" if over_time else "place")
    return Picture(name=f"field-{slug(name)}", title=f"{name}: band and what makes its scatter", figure=figure)
