"""Circuits: from a netlist to its equations, operating point and dynamics."""
