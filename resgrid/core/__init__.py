"""Configuration spaces, boundary conditions and netlists, and `compile_space`, which converts spaces to netlists.

The modules of this package may import only `_internal` and `errors`; they do not depend on scenes, robots or solvers.
"""
