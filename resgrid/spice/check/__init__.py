"""Checking circuits: electrical rules, what simulators would make of them, and what they did."""
