"""Linear solvers for graph Laplacians ``A x = b``: conductances in siemens, currents in amperes, voltages in volts.

Solvers may import only `_internal` and `errors`; they do not depend on netlists, spaces or scenes.
"""
