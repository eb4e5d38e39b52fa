"""What a person sees of a run: a bar with its stage, the share that is done and the time left, or
lines.
"""

import contextlib
import math
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

#: called with model runs, the share of the work that is done (an estimate; nan where only the stage
#: moves), and a text
Progress = Callable[[int, float, str], None]
#: seconds between two lines
EVERY = 3.0
FORMAT = "{percentage:3.0f}%|{bar:20}| {elapsed}<{remaining}{postfix}"


@contextlib.contextmanager
def watched(*, lines: bool = False) -> Iterator[Progress]:
    """A bar in a notebook and on a terminal; elsewhere nothing, or `lines` every few seconds; all
    on stderr.
    """
    # in a notebook tqdm has a widget of its own
    shell: Any = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    notebook = getattr(shell, "kernel", None) is not None
    if notebook or (sys.stderr.isatty() and os.environ.get("TERM") != "dumb"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a notebook without widgets has a bar of text
            from tqdm.auto import tqdm

            bar = tqdm(
                total=1.0, leave=False, bar_format=None if notebook else FORMAT, file=sys.stderr
            )

        def show(runs: int, share: float, text: str) -> None:
            if math.isfinite(share) and share > bar.n:
                bar.update(share - bar.n)
            bar.set_postfix_str(f"{runs:,} runs, {text}")

        with bar:
            yield show
        return
    last = [time.monotonic()]

    def line(runs: int, share: float, text: str) -> None:
        if lines and time.monotonic() - last[0] > EVERY:
            last[0] = time.monotonic()
            about = "" if math.isnan(share) else f", about {share:.0%} done"
            print(f"{runs:,} runs, {text}{about}", file=sys.stderr)

    yield line
