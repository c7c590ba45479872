"""Benchmarks: ratios measured in one run, alternating, as medians.  ``make bench`` runs them."""
