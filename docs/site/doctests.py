"""Examples in docstrings as blocks of code, wherever they stand."""

from __future__ import annotations

import re
from typing import Any, Final

import griffe

#: an example with its output, up to the next empty line
EXAMPLE: Final = re.compile(r"(?m)^>>> .*(?:\n(?!\s*$).+)*")


class Doctests(griffe.Extension):
    """Put fences around examples."""

    def on_object(self, *, obj: Any, **_: Any) -> None:
        """Change the docstring of a module, class, function or attribute."""
        if obj.docstring is not None:
            fenced = EXAMPLE.sub(lambda match: f"```pycon\n{match[0]}\n```", obj.docstring.value)
            obj.docstring.value = fenced
