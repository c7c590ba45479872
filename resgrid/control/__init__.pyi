"""Public names of `resgrid.control`."""

from resgrid.scene.control import Control as Control

from .controller import (
    Controller as Controller,
    make_controller as make_controller,
)
from .equipotential import equipotential_velocity as equipotential_velocity
from .external_forces import ExternalForce as ExternalForce, random_forces as random_forces
from .run_log import (
    ContactLog as ContactLog,
    ControlMode as ControlMode,
    MapUpdate as MapUpdate,
    Run as Run,
    TerminationReason as TerminationReason,
)
from .simulation import Simulation as Simulation
from .wavefronts import Wavefront as Wavefront, wavefront as wavefront
