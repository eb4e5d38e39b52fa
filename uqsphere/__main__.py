"""`uqsphere` and `python -m uqsphere`: the command line, whose interruption is told in one line,
also while it is being loaded.
"""

import os
import sys


def program() -> None:
    """The entry point: ends with the exit code of a command."""
    code = 130
    try:
        from uqsphere.cli import program as run

        code = run()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
    # CPython ends by the signal, not by the code, where the last text that was executed (that of a
    # named tuple, say) was interrupted
    exec("")
    sys.exit(code)


if __name__ == "__main__":
    # as for the installed command: a random.py of the working folder does not stand for Python's
    # own
    if sys.path[0] == os.getcwd() != os.path.dirname(os.path.dirname(os.path.abspath(__file__))):
        del sys.path[0]
    program()
