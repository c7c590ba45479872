"""Circuits: from a netlist to its equations, operating point, transient and effective values."""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
