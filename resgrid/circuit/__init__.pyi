from resgrid.core.conductivity_derivatives import conductivity_gradient as conductivity_gradient

from .adjoint_gradient import Gradient as Gradient
from .batch import solve_many as solve_many
from .driven_pairs import PairCurrents as PairCurrents, pair_currents as pair_currents
from .effective_resistance import (
    EffectiveResistance as EffectiveResistance,
    ReducedNetwork as ReducedNetwork,
    reduce_network as reduce_network,
)
from .gradients import pullback as pullback
from .jax_functions import jax_solver as jax_solver
from .linear import CircuitFactor as CircuitFactor
from .nonlinear import linearize as linearize
from .transients.linear import (
    Transient as Transient,
    TransientStepper as TransientStepper,
    transient as transient,
    transient_stepper as transient_stepper,
)
from .transients.memristive import (
    MemristiveTransient as MemristiveTransient,
    memristive_transient as memristive_transient,
)
from .transients.memristors import MemristiveCircuit as MemristiveCircuit, Memristor as Memristor
from .warm_start import WarmPoint as WarmPoint, WarmStart as WarmStart
