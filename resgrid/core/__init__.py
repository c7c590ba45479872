"""Configuration spaces, frames, lattices, wirings and netlists; `compile_space` converts a space to a netlist.

The modules of this package may import only `_internal` and `errors`; they do not depend on scenes, robots or solvers.
"""
