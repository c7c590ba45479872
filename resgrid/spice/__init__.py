"""SPICE decks: dialects, readers, writers, simulator runs and checks; power balance and IR drop of a circuit.

This package may import `resgrid.circuit` and packages below it; it does not depend on fields, paths or chip analyses.

`dialects` describes each simulator as data.  `read` and `networks` read circuits from files.  `write` turns a netlist
into a deck, simulator commands and a sidecar.  `run` runs a simulator on a deck.  `check` applies the electrical rule
check (ERC) to a circuit, predicts how each simulator reads its deck, and compares simulated with expected voltages.

>>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 1e-3], source_nodes=[[1, 0]], source_volts=[2.0])
>>> round(rg.spice.power_balance(rg.solve(divider)).delivered, 6)
0.002
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
