"""Circuits: from a netlist to its equations, operating point, transient and effective values.

Circuits may import `solvers` and `core`; they do not depend on scenes, decks or paths.
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
