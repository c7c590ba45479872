"""Linear solvers for Laplacians: `(matrix, right-hand side, grid or None) -> x`.

Solvers may import only `_internal` and `errors`; they do not depend on netlists, spaces or scenes.
"""
