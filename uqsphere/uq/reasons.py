"""How the reasons begin of moments that are not given: what is not there, and what is not known, are told apart."""

from __future__ import annotations

from typing import Final

__all__ = ["NOT_KNOWN", "NO_CONVERGENCE", "NO_MOMENT", "OUT_OF_REACH", "UNTOLD"]

#: of one that a law of the inputs leaves none of, or that the samples rule out
NO_MOMENT: Final = "does not exist: "
#: of one that may exist, which no number of samples would tell
UNTOLD: Final = "not to be told from samples: "
#: of one that more evaluations may give
NOT_KNOWN: Final = "not known: "
#: of a standard deviation that one of many samples makes
NO_CONVERGENCE: Final = "does not converge: "
#: those whose accuracy is not pursued
OUT_OF_REACH: Final = (NO_MOMENT, UNTOLD)
