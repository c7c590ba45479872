"""Configuration spaces, boundary conditions and netlists, and `compile_space`, which makes the one from the other."""
