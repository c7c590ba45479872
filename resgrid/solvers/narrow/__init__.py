"""Factors of narrow circuits, made along their corridors in positive numbers alone."""
