"""What `resgrid` offers, and where it lives; read at run time too, so that names are imported when first used."""

from . import chip as chip
from ._internal.executors import open_executor as open_executor
from ._internal.parallel import spread as spread
from .chip.build import build_chip as build_chip
from .chip.study_analyses import study as study
from .circuit.batch import solve_many as solve_many
from .circuit.nonlinear import small_signal as small_signal
from .circuit.operating_point import OperatingPoint as OperatingPoint
from .circuit.solve import factor as factor, scale_drive as scale_drive, solve as solve
from .circuit.transient import transient as transient, transient_stepper as transient_stepper
from .circuit.warm_start import WarmStart as WarmStart
from .control.controller import equipotential_velocity as equipotential_velocity, make_controller as make_controller
from .control.external_forces import Push as Push, random_pushes as random_pushes
from .control.run_log import Ending as Ending, Mode as Mode, Run as Run
from .control.simulation import simulation as simulation, wavefront as wavefront
from .core.axis import Axis as Axis
from .core.compiler import compile_space as compile_space
from .core.frame import Frame as Frame
from .core.netlist import Netlist as Netlist
from .core.space import Cell as Cell, ConfigurationSpace as ConfigurationSpace
from .core.wiring import Wiring as Wiring
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
from .io.networks import write_network as write_network
from .io.paths import write_path as write_path
from .io.ros_paths import ros_plan as ros_plan
from .io.runs import write_run as write_run
from .io.solutions import write_solution as write_solution
from .live_page.live import live as live
from .planning.blend import blend as blend
from .planning.blocking_obstacles import separation as separation
from .planning.certify import certify as certify, certify_free as certify_free
from .planning.fields import Field as Field, field as field
from .planning.planner import clearance_curve as clearance_curve, plan as plan
from .planning.random_walk import (
    collision_probability as collision_probability,
    hitting_probability as hitting_probability,
    random_walk as random_walk,
)
from .planning.shortcut import shorten as shorten
from .planning.streamline import Outcome as Outcome, Polyline as Polyline, Streamline as Streamline, unwrap as unwrap
from .planning.surface_normals import surface_normals as surface_normals
from .planning.time_parameterization import time_path as time_path
from .planning.trace import basins as basins, streamline as streamline, streamlines as streamlines
from .planning.workspace import (
    replay as replay,
    workspace_clearance as workspace_clearance,
    workspace_path as workspace_path,
)
from .plot import (
    animate as animate,
    draw as draw,
    draw_dirichlet_share as draw_dirichlet_share,
    draw_page as draw_page,
    draw_pair as draw_pair,
    draw_robot as draw_robot,
    draw_tips as draw_tips,
    draw_velocities as draw_velocities,
    save_figure as save_figure,
)
from .robots import (
    Arm as Arm,
    Ball as Ball,
    Box as Box,
    DiscRobot as DiscRobot,
    HalfSpace as HalfSpace,
    PointRobot as PointRobot,
    Polygon as Polygon,
    PolygonRobot as PolygonRobot,
    Robot as Robot,
)
from .scene import (
    Chip as Chip,
    Control as Control,
    CostArea as CostArea,
    Defects as Defects,
    GoalCell as GoalCell,
    GoalJoints as GoalJoints,
    GoalPoint as GoalPoint,
    Readout as Readout,
    Scene as Scene,
    occupancy_grid as occupancy_grid,
    parse_scene as parse_scene,
    read_queries as read_queries,
    read_scene as read_scene,
    sample as sample,
)
from .scene.schema import scene_schema as scene_schema
from .spice import analyses as analyses
from .spice.check.deck import check_deck as check_deck
from .spice.check.erc import check_rules as check_rules
from .spice.check.portability import predict_simulators as predict_simulators
from .spice.power import ir_drop as ir_drop, power_balance as power_balance
from .spice.read.deck import read_spice as read_spice
from .spice.write.files import write_spice as write_spice

__version__: str
