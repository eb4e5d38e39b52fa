"""Lab for comminution: tests of single particles to a posterior of their fracture energy, and a
feed under blows.
"""
