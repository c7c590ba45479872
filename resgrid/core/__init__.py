"""Configuration spaces, boundary conditions and netlists, and `compile_space`, which converts spaces to netlists."""
