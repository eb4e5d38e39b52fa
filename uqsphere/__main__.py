"""`python -m uqsphere`."""

import sys
from pathlib import Path

# as for the installed command: a random.py of the working folder does not stand for Python's own
if Path(sys.path[0]) == Path.cwd() != Path(__file__).parents[1]:
    del sys.path[0]

from uqsphere.cli import program

program()
