"""Public names of `resgrid.planning`."""

from .blocking_obstacles import (
    Obstruction as Obstruction,
    SceneSeparation as SceneSeparation,
    Separation as Separation,
)
from .legs import Leg as Leg, LegPath as LegPath
from .normals import surface_normals as surface_normals
from .planner import ClearanceCurve as ClearanceCurve, Planner as Planner, clearance_curve as clearance_curve
from .random_walks import (
    CollisionProbability as CollisionProbability,
    HittingProbability as HittingProbability,
    RandomWalk as RandomWalk,
    collision_probability as collision_probability,
    hitting_probability as hitting_probability,
    random_walk as random_walk,
)
from .streamline import ShortPath as ShortPath, unwrap as unwrap
from .time_parameterization import Trajectory as Trajectory
from .trace import Traces as Traces
from .workspace import (
    Collision as Collision,
    workspace_clearance as workspace_clearance,
    workspace_path as workspace_path,
)
