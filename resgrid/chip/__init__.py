"""The chip: what real devices make of the circuit, and whether it is good enough to drive a robot."""

from resgrid._internal.public import attach

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

__getattr__, __dir__, __all__ = attach(__name__, __file__)
