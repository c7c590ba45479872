"""Shared helpers of tests: small spaces, circuits and decks, worlds with hidden obstacles, simulators."""
