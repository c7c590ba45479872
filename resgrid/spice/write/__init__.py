"""Writers of SPICE decks, flat or one subcircuit per cell, with expected results (sidecar) and self-checks."""
