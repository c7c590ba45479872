"""Configuration spaces, boundary conditions and netlists, and `compile_space`, which converts spaces to netlists.

Core may import only `_internal` and `errors`; it does not depend on scenes, robots or solvers.
"""
