"""Nodal analysis: assemble, solve, read off the operating point."""
