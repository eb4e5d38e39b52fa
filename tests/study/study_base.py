"""A study in order, of each kind, which the tests of this room change."""

BASE = """\
title = "granite"
seed = 7

[sphere]
material = "granite"
E = { dist = "lognormal", mean = "52 GPa", cov = 0.12 }
nu = 0.25
radius = { dist = "normal", mean = "10 mm", sd = "0.15 mm", lower = "9 mm" }

[bars]
material = "maraging_steel"
diameter = "40 mm"
incident_length = "1.5 m"
receiving_length = "1.5 m"
incident_end = "free"

[striker]
speed = { dist = "normal", mean = "0.5 m/s", cov = 0.02 }
length = "0.8 m"

[pulse]
shape = "trapezoid"
rise = "25 us"
fall = "25 us"

[model]
tolerance = 1e-6

[limits.crushing]
quantity = "p_max"
strength = { dist = "weibull", mean = "4 GPa", modulus = 12 }
target = 0.01

[[dependence]]
of = ["sphere.E", "limits.crushing.strength"]
spearman = 0.6

[analysis]
quantities = ["p_max"]
quantiles = [0.05, 0.5]

[margins]
solve = "striker.speed"
between = ["0.05 m/s", "20 m/s"]
"""

BLACK_BOX = """\
[inputs]
x1 = { dist = "uniform", lower = -1, upper = 1 }
x2 = 2.0

[outputs]
names = ["y"]
"""
