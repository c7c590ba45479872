"""The chip: what real devices make of the circuit, and whether it is good enough to drive a robot."""

from resgrid.chip import passes as passes
