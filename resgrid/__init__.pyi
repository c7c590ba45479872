"""The public names of `resgrid`, read at run time as well: names are imported when they are first used."""

from . import (
    chip as chip,
    circuit as circuit,
    control as control,
    hardware as hardware,
    maps as maps,
    planning as planning,
    plot as plot,
    processes as processes,
    spice as spice,
)
from ._internal.executors import open_executor as open_executor
from ._internal.parallel import spread as spread
from .chip.study_analyses import study as study
from .circuit.effective_resistance import effective_resistance as effective_resistance
from .circuit.gradients import gradient as gradient
from .circuit.operating_point import OperatingPoint as OperatingPoint
from .circuit.solve import factorize as factorize, normalize_drive as normalize_drive, solve as solve
from .control.simulation import simulation as simulation
from .core.axis import Axis as Axis
from .core.cell import Cell as Cell
from .core.compiler import compile_space as compile_space
from .core.frame import Frame as Frame
from .core.netlist import Netlist as Netlist
from .core.space import ConfigurationSpace as ConfigurationSpace
from .core.wiring import Wiring as Wiring, WiringOptions as WiringOptions
from .errors import (
    AccuracyError as AccuracyError,
    BudgetError as BudgetError,
    CertificateError as CertificateError,
    CircuitError as CircuitError,
    InputError as InputError,
    ResgridError as ResgridError,
    ToolMissingError as ToolMissingError,
    WorkerError as WorkerError,
)
from .io.saving import save as save
from .live_page.launch import live as live
from .planning.blend import blend as blend
from .planning.blocking_obstacles import find_blocking_obstacles as find_blocking_obstacles
from .planning.certify import certify as certify
from .planning.certify_segments import certify_collision_free as certify_collision_free
from .planning.fields import Field as Field, field as field
from .planning.legs import plan_legs as plan_legs
from .planning.planner import plan as plan
from .planning.shortcuts import shortcut as shortcut
from .planning.streamline import Outcome as Outcome, Polyline as Polyline, Streamline as Streamline
from .planning.time_parameterization import time_parameterize as time_parameterize
from .planning.trace import basins as basins, streamline as streamline, streamlines as streamlines
from .planning.workspace import check_collisions as check_collisions
from .plot.animations import animate as animate
from .plot.pictures import draw as draw
from .robots import (
    Arm as Arm,
    Ball as Ball,
    Box as Box,
    Capsule as Capsule,
    Cylinder as Cylinder,
    DiscRobot as DiscRobot,
    HalfSpace as HalfSpace,
    Mesh as Mesh,
    OrientedBox as OrientedBox,
    PointRobot as PointRobot,
    Polygon as Polygon,
    PolygonRobot as PolygonRobot,
    Robot as Robot,
    URDFRobot as URDFRobot,
    Voxels as Voxels,
)
from .scene import (
    Chip as Chip,
    CostArea as CostArea,
    GoalCell as GoalCell,
    GoalJoints as GoalJoints,
    GoalPoint as GoalPoint,
    GoalPose as GoalPose,
    Mask as Mask,
    Scene as Scene,
    build_space as build_space,
    parse_scene as parse_scene,
    read_scene as read_scene,
)
from .scene.schema import scene_schema as scene_schema
from .spice.check.deck import check_deck as check_deck
from .spice.check.erc import check_erc as check_erc
from .spice.read.deck import read_spice as read_spice
from .spice.write.files import write_spice as write_spice

__version__: str
from .viewer.launch import view as view
