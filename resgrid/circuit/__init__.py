"""Circuit analysis of netlists: nodal equations, operating points, transients, effective resistances, gradients.

>>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 1e-3], source_nodes=[[1, 0]], source_volts=[2.0])
>>> rg.circuit.solve_many(divider, [[1e-3, 1e-3], [1e-3, 3e-3]])[:, 2].round(6)
array([1. , 0.5])
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
