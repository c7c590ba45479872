"""The chip: effects of real devices on the circuit, and analyses of its accuracy, speed, noise and yield."""

import lazy_loader

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

# Effects are imported lazily, so that reading `ANALYSES` is cheap.
__getattr__, _, _ = lazy_loader.attach(__name__, ["effects"])
