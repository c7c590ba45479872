"""Harmonic control (Connolly & Grupen 1992, sections 3.4 and 5 to 7): velocities, contacts, learnt obstacles.

Control may import `planning` and packages below it; it does not depend on pictures or result files.
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
