"""The chip: effects of real devices on the circuit, and analyses of its accuracy, speed, noise and yield.

`resgrid.study` puts a chip under study; its methods return the result types of this package.

>>> power = rg.study(rg.read_scene("examples/scenes/lesson.toml")).power()
>>> isinstance(power, rg.chip.Power), f"{power.total:.4g} W"
(True, '0.0002462 W')
"""

from resgrid._internal.public import attach

ANALYSES = (
    "yield",
    "yield_loss",
    "adc_resolution",
    "settling",
    "plan_energy",
    "noise",
    "power",
    "sensitivity",
    "sweep",
    "defects",
)
"""Names of the analyses of `resgrid chip`, in the order of the report; see `resgrid.chip.report`."""

__getattr__, __dir__, __all__ = attach(__name__, __file__)
