"""The chip: what real devices make of the circuit, and whether it is good enough to drive a robot."""

import lazy_loader

ANALYSES = (
    "yield",
    "yield_loss",
    "precision",
    "settling",
    "noise",
    "power",
    "sensitivity",
    "exploration",
    "defects",
)
"""Every analysis, in the order of the report; see `resgrid.chip.report`."""

# The effects are loaded when they are asked for: the names above cost nothing.
__getattr__, _, _ = lazy_loader.attach(__name__, ["effects"])
