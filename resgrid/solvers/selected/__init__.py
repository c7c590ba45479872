"""Chosen entries of the inverse of a nodal matrix."""
