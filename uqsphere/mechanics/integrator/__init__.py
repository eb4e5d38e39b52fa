"""Numerical integration of the equations of motion of a batch of scenes."""
