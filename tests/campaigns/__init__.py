"""Evidence: measurements too long for a test, each run by `python -m tests.campaigns.NAME`
(docs/validation.md).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from typing import Any


def options(
    about: str | None,
    arguments: Sequence[str] | None = None,
    *,
    words: Iterable[str] | None = None,
    **defaults: Any,
) -> argparse.Namespace:
    """What a campaign is asked: `words` one after the other (those allowed; any if none are), and
    options by defaults.

    A default of False is a flag, a list takes one or more, a type has no default.
    """
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    if words is not None:
        allowed = [*words]
        parser.add_argument(
            "words", nargs="*", choices=[*allowed, []] if allowed else None, default=[]
        )
    for name, default in defaults.items():
        option = f"--{name.replace('_', '-')}"
        if default is False:
            parser.add_argument(option, action="store_true")
        elif isinstance(default, list):
            parser.add_argument(option, nargs="+", type=type(default[0]), default=default)
        else:
            known = (
                {"type": default}
                if isinstance(default, type)
                else {"type": type(default), "default": default}
            )
            parser.add_argument(option, **known)
    return parser.parse_args(arguments)


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table in Markdown."""
    return "\n".join(
        "| " + " | ".join(map(str, row)) + " |" for row in [header, ["---"] * len(header), *rows]
    )


def tell(text: str) -> None:
    """Progress, which is not the result."""
    print(text, file=sys.stderr, flush=True)
