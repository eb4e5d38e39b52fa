"""Particles of a feed: fracture energies over size, repeated blows, what tests tell of them, populations, DEM.

Pure functions of arrays and frozen nouns, in SI, energies per mass in J/kg of what the particle itself takes up.  No
module here knows a study file: `uqsphere.study` reads tables into these nouns and `uqsphere.cli` brings both together.
"""
