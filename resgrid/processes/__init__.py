"""Public names for chip processes: types of their data (layers, design rules, resistors, mismatch) and their reader.

>>> rg.processes.read_process("ihp-sg13g2:rhigh").resistor.sheet_resistance
1360.0
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
