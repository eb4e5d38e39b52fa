"""Sparse polynomial chaos in standardised germs: what it is in (`basis`), the expansion with its
values, moments, Sobol' indices and chaospy's objects (`expansion`), and its fit (`fit`).
"""
