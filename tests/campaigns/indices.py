"""Total Sobol' indices of peak contact pressure and contact duration: chaos from 256 runs beside
pairs, by SALib.

python -m tests.campaigns.indices [--base 8192]
"""

from __future__ import annotations

from typing import Final

from SALib.analyze import sobol

import uqsphere
from tests.campaigns import options, table
from uqsphere import analysis
from uqsphere.study import shipped_studies

STUDIES: Final = ("granite", "glass_bead_small_bar", "limestone_margin")
QUANTITIES: Final = ("p_max", "contact_duration")


def compare(name: str, base: int) -> list[list[str]]:
    """Rows of a study: an index by 256 runs with its interval, and by `base` pairs with SALib's
    own.
    """
    study = uqsphere.load_study(shipped_studies()[name])
    few, pairs = uqsphere.design(study, 256), uqsphere.to_salib(study, base)
    names = pairs.problem["names"]
    of_few = uqsphere.evaluate(study, few, quantities=QUANTITIES)
    of_pairs = uqsphere.evaluate(
        study, dict(zip(names, pairs.rows.T, strict=True)), quantities=QUANTITIES
    )
    rows = []
    for quantity in QUANTITIES:
        own = analysis.chaos(few, of_few[quantity], study.random).indices()["total"]
        theirs = sobol.analyze(
            pairs.problem, of_pairs[quantity].to_numpy(), calc_second_order=False, seed=1
        )
        for one, total, half in zip(names, theirs["ST"], theirs["ST_conf"], strict=True):
            e = own[one]
            by_chaos = (
                f"{e.value:.4f} ({e.low:.4f} to {e.high:.4f})"
                if e.value is not None
                else f"– ({e.reason})"
            )
            rows.append([name, quantity, one, by_chaos, f"{total:.4f} ± {half:.4f}"])
    return rows


if __name__ == "__main__":
    count = options(__doc__, base=8192).base
    found = [row for name in STUDIES for row in compare(name, count)]
    print(
        table(["study", "quantity", "input", "chaos, 256 runs", f"SALib, {count:,} pairs"], found)
    )
