"""Robots: which cells of a grid are free."""
