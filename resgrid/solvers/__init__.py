"""Solvers: a matrix of conductances, a right-hand side, and a grid or none; they know no netlist."""
