"""Factors: what every method makes of a nodal system, to solve it for many right-hand sides."""
