"""Models: rows of inputs go in, columns of answers come out. The only place where physics meets
probability.

Nothing is imported here: a process that calls a black box needs neither studies nor mechanics.
"""
