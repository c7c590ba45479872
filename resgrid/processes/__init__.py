"""Chip processes as data: sheet resistances, design rules, mismatch and temperature coefficients."""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
