"""Uncertainty: laws, inputs, sampling, estimates, surrogates, sensitivity, reliability and margins.

Knows only arrays and callables rows -> rows; the physics is somewhere else.
"""
