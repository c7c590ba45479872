"""Public names of `resgrid.circuit`."""

from .batch import solve_many as solve_many
from .linear import CircuitFactor as CircuitFactor
from .nonlinear import linearize as linearize
from .transients import (
    Transient as Transient,
    TransientStepper as TransientStepper,
    transient as transient,
    transient_stepper as transient_stepper,
)
from .warm_start import WarmPoint as WarmPoint, WarmStart as WarmStart
