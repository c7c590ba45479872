"""Exact elimination of nodes with at most two neighbours, in front of every method."""
