"""Writers of SPICE decks: flat, one subcircuit per cell, or with memristors; their sidecars and self-check decks."""
