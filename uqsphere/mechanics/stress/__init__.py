"""Stress inside a sphere under Hertz pressure on two caps: series, surface, axis, weakest link, tables."""
