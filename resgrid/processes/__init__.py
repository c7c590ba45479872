"""Chip processes as data: resistances, design rules, mismatch and temperature coefficients, each with its source."""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
