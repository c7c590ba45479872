"""Linear solvers for Laplacians: `(matrix, right-hand side, grid or None) -> x`. They do not depend on netlists."""
