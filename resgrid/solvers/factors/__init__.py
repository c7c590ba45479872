"""Factors: what every method makes of a nodal laplacian, to solve it for many right-hand sides."""
