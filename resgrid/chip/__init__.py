"""The chip: effects of real devices on the circuit, and analyses of its accuracy, speed, noise and yield.

The chip may import `planning`, `spice` and packages below them; it does not depend on control, pictures or result
files.
"""

from resgrid._internal.public import attach

ANALYSES = (
    "yield",
    "yield_loss",
    "adc_resolution",
    "settling",
    "noise",
    "power",
    "sensitivity",
    "sweep",
    "defects",
)
"""Names of the analyses of `resgrid chip`, in the order of the report; see `resgrid.chip.report`."""

__getattr__, __dir__, __all__ = attach(__name__, __file__)
