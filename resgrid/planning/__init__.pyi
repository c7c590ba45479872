"""Public names of `resgrid.planning`."""

from .any_path import unwrap as unwrap
from .blocking_obstacles import (
    Obstruction as Obstruction,
    SceneSeparation as SceneSeparation,
    Separation as Separation,
)
from .clearance_curves import ClearanceCurve as ClearanceCurve, clearance_curve as clearance_curve
from .lattice_fields import LatticeField as LatticeField, lattice_field as lattice_field
from .legs import Leg as Leg, LegPath as LegPath
from .node_paths import NodePath as NodePath, node_path as node_path
from .normals import surface_normals as surface_normals
from .planner import Planner as Planner
from .random_walks import (
    CollisionProbability as CollisionProbability,
    HittingProbability as HittingProbability,
    RandomWalk as RandomWalk,
    collision_probability as collision_probability,
    hitting_probability as hitting_probability,
    random_walk as random_walk,
)
from .replanning import Replanning as Replanning
from .short_path import ShortPath as ShortPath
from .time_parameterization import Trajectory as Trajectory
from .trace import Traces as Traces
from .workspace import (
    Collision as Collision,
    workspace_clearance as workspace_clearance,
    workspace_path as workspace_path,
)
