"""`python -m uqsphere`."""

from uqsphere.cli import program

program()
