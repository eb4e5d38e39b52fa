"""The command line: one command run, its errors printed, its exit code given."""

from __future__ import annotations

import argparse
import os
import shlex
import signal
import sys
import threading
from collections.abc import Sequence
from importlib import import_module
from types import FrameType

from uqsphere.cli.parser import build_parser
from uqsphere.console import outlets, plain_lines
from uqsphere.errors import AccessError, UqsphereError

__all__ = ["build_parser", "main"]

#: exit codes beside those of the error family
INTERRUPTED, TERMINATED = 130, 143

# no plugin of pydantic's concerns a study, and looking for them reads every installed package's metadata
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")


class _Terminated(BaseException):
    """The system asks this process to end (SIGTERM)."""


def _terminate(number: int, frame: FrameType | None) -> None:
    raise _Terminated


def _go_on(chosen: argparse.Namespace | None, arguments: Sequence[str]) -> str:
    """How to go on after an interruption; the command that does it never drops what is stored."""
    if chosen is None or chosen.command != "run":
        return "interrupted"
    again = [word for word in arguments if not (chosen.fresh and word.startswith("--f"))]
    return f"interrupted; what was evaluated is kept, and this goes on with it:\n  uqsphere {shlex.join(again)}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit code.  Errors of the family are printed, never raised."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    handler = None
    if threading.current_thread() is threading.main_thread():
        handler = signal.signal(signal.SIGTERM, _terminate)
    try:
        with outlets():
            return _carry_out(given)
    finally:
        if handler is not None:
            signal.signal(signal.SIGTERM, handler)


def _carry_out(given: Sequence[str]) -> int:
    """One command; the exit code."""
    chosen: argparse.Namespace | None = None
    try:
        chosen = build_parser().parse_args(given)
        does = getattr(import_module(chosen.module), f"command_{chosen.command.replace('-', '_')}")
        code = int(does(chosen))
        sys.stdout.flush()
        return code
    except UqsphereError as error:
        text = plain_lines(str(error))
        print(f"uqsphere: {text}" if not hasattr(error, "problems") else text, file=sys.stderr)
        return error.exit_code
    except (KeyboardInterrupt, _Terminated) as error:
        print(f"\nuqsphere: {_go_on(chosen, given)}", file=sys.stderr)
        return TERMINATED if isinstance(error, _Terminated) else INTERRUPTED
    except Exception as error:
        return _unforeseen(error)


def _unforeseen(error: Exception) -> int:
    """Tell of an error that is none of the family; the exit code."""
    if os.environ.get("UQSPHERE_DEBUG"):
        raise error
    if isinstance(error, OSError):
        print(f"uqsphere: {error.filename or 'input/output'}: {error.strerror or error}", file=sys.stderr)
        return AccessError.exit_code
    if isinstance(error, MemoryError):
        print("uqsphere: out of memory: lower analysis.budget.evaluations, or use a larger machine", file=sys.stderr)
    else:
        print(
            f"uqsphere: internal error: {type(error).__name__}: {error}\n"
            "  this is a fault of uqsphere; set UQSPHERE_DEBUG=1 to see where it happened",
            file=sys.stderr,
        )
    return UqsphereError.exit_code
