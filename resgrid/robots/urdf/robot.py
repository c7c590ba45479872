"""`URDFRobot`, the robot of a URDF file: its joint axes, kinematics, proven free cells, and goal cells of its tool."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import tau
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Le, Len
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.cache import load_array, store_array, unfinished_file
from resgrid._internal.validation import checked
from resgrid._internal.values import brief
from resgrid.core.axis import LARGEST, Axis, Point
from resgrid.core.cell import MAX_DIMENSIONS
from resgrid.errors import InputError, suggestion
from resgrid.robots.base import Robot
from resgrid.robots.cells import CellClasses, GoalCells, Progress, Sampling
from resgrid.robots.collision_tests import CollisionTest
from resgrid.robots.geometry import RigidPart
from resgrid.robots.shapes import Shape
from resgrid.robots.urdf.reach import motion_per_joint
from resgrid.robots.urdf.tool_goals import ToolGoal, tool_goal_cells, tool_poses
from resgrid.robots.urdf.tree import KinematicTree

Rate = Annotated[float, Gt(0), Le(LARGEST)]


@checked
@brief
@dataclass(frozen=True, eq=False)
class URDFRobot(Robot):
    """A robot that a URDF file describes, of which one to four joints move.

    Its configuration space has one axis per moving joint, in radians or metres; continuous joints are periodic.  With
    the sampling ``"conservative"`` a cell is free only if a bound on distances proves that no configuration in it
    collides with an obstacle or with the robot itself.  The extra ``robots`` contains the required packages.

    Parameters
    ----------
    file : str
        Name of the URDF file; in a scene file relative to the scene's folder.
    moving : tuple of str
        Names of the one to four moving joints (revolute, continuous or prismatic), in the order of the axes.
    at : mapping of str to float
        Values of other joints, in radians or metres; 0, or the limit closest to 0, for joints that are not named.
    packages : tuple of str
        Folders in which ``package://`` names of meshes are searched.
    srdf : str or None
        Name of an SRDF file, whose disabled pairs of links are not tested for collisions.  Without it, only links that
        one joint connects are not tested.
    base : tuple of float
        Pose of the robot's root in the world: x, y, z in metres, then roll, pitch and yaw in radians.
    tool : str or None
        Link, with or without geometry, whose origin is the reference point of goals; None for a link that the last
        joint carries.
    padding : float
        Distance in metres by which all links are enlarged in proofs, but not in collision tests.
    mounted : tuple of str
        Links that may touch obstacles, such as the base on its table.
    self_collision : bool
        True: contacts between links of the robot are collisions.  False: only contacts with obstacles are.
    pieces : int
        Maximum number of convex pieces that cover one mesh in proofs.
    halvings : int
        A cell is halved at most this number of times for every moving joint; a cell that is not decided by then stays
        undecided, and is blocked.
    velocity : tuple of float
        Largest speeds of trajectories in rad/s or m/s, one for all moving joints or one per joint, in place of the
        limits in the URDF file; empty for those limits.
    acceleration : tuple of float
        Largest accelerations of trajectories in rad/s² or m/s², one for all moving joints or one per joint; empty for
        no limit.  URDF files have no such limits.

    Raises
    ------
    InputError
        If the file, a mesh or the SRDF file is invalid, or a joint or link is unknown.
    ToolMissingError
        If the packages of the extra ``robots`` are not installed.

    Examples
    --------
    >>> robot = rg.URDFRobot("examples/robots/scara.urdf", moving=("shoulder", "elbow"), tool="tip")
    >>> [axis.name for axis in robot.axes(32)], robot.velocity_limits
    (['shoulder', 'elbow'], array([ 6.5, 11. ]))
    >>> robot.tool_poses([(0.0, 0.0)])[0, :3, 3].round(3)
    array([0.48 , 0.   , 0.155])
    """

    reference = "tool"
    workspace_ndim = 3

    file: str
    moving: Annotated[tuple[str, ...], Len(1, MAX_DIMENSIONS)]
    at: Mapping[str, float] = field(default_factory=dict)
    packages: tuple[str, ...] = ()
    srdf: str | None = None
    base: Point = (0.0,) * 6
    tool: str | None = None
    padding: Annotated[float, Ge(0), Le(1)] = 0.0
    mounted: tuple[str, ...] = ()
    self_collision: bool = True
    pieces: Annotated[int, Ge(1), Le(64)] = 8
    halvings: Annotated[int, Ge(0), Le(10)] = 5
    velocity: tuple[Rate, ...] = ()
    acceleration: tuple[Rate, ...] = ()

    def __post_init__(self) -> None:
        if len(self.base) != 6:
            raise InputError(f"base needs six numbers (x, y, z, roll, pitch, yaw), got {list(self.base)}")
        for name in ("velocity", "acceleration"):
            if len(getattr(self, name)) not in (0, 1, self.ndim):
                raise InputError(
                    f"{name} needs one number for each of the {self.ndim} moving joints, or one for all, got "
                    f"{list(getattr(self, name))}"
                )
        tools = self.tree.tools
        if self.tool is not None and self.tool not in tools:
            raise InputError(
                f"{self.file} has no link or frame {self.tool!r}; {suggestion(self.tool, tools) or 'choose a link'}"
            )

    @cached_property
    def tree(self) -> KinematicTree:
        """Joints and bodies of the robot as arrays, without its surroundings."""
        from resgrid.robots.urdf.model import read_tree

        tree = read_tree(
            self.file, self.moving, self.at, packages=self.packages, srdf=self.srdf, base=self.base,
            padding=self.padding, pieces=self.pieces,
        )  # fmt: skip
        return tree if self.self_collision else replace(tree, pairs=tree.pairs[:0])

    @property
    def ndim(self) -> int:
        """Number of moving joints."""
        return len(self.moving)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints in the URDF file."""
        return self.moving

    @property
    def fixed_joints(self) -> Mapping[str, float]:
        """Values, in radians or metres, of the joints that `at` names."""
        return self.at

    @property
    def velocity_limits(self) -> NDArray[np.float64]:
        """Largest speeds of the moving joints (m,) in rad/s or m/s: `velocity`, or those of the URDF file.

        A limit is infinite for a joint without one; a limit of 0, which some files use for an unknown limit, too.
        """
        given = np.asarray(self.velocity or np.where(self.tree.velocity > 0, self.tree.velocity, np.inf))
        return np.array(np.broadcast_to(given, (self.ndim,)))

    @property
    def acceleration_limits(self) -> NDArray[np.float64] | None:
        """Largest accelerations of the moving joints (m,) in rad/s² or m/s²; None without limits."""
        return np.array(np.broadcast_to(self.acceleration, (self.ndim,))) if self.acceleration else None

    @property
    def tool_name(self) -> str:
        """Name of the link whose origin is the reference point of goals: `tool`, or a link of the last joint."""
        if self.tool is not None:
            return self.tool
        return max(self.tree.tools, key=lambda name: self.tree.tools[name][0])

    @property
    def remedy(self) -> str:
        """Advice that error messages append if obstacles leave no free cell; empty without padding."""
        return "choose other values of the joints that do not move (at), or a smaller padding" * (self.padding > 0)

    @property
    def reach(self) -> float:
        """Approximate largest distance from the base to a point of the robot, in metres, for views.

        It is the sum of all distances between joint origins and of the largest distance of a hull point from its joint;
        translations of prismatic joints and the radii of hulls are not included.
        """
        origins = np.linalg.norm(self.tree.placement[:, :3, 3], axis=1).sum()
        return float(origins + max(np.linalg.norm(body.hull.points, axis=1).max() for body in self.tree.bodies))

    def axes(self, cells: int | Sequence[int]) -> tuple[Axis, ...]:
        """Return the axes of the configuration space: one per moving joint, with its name and the range of its limits.

        `cells`: number of cells of each axis, a single one for all joints or one per joint.
        """
        counts = [cells] * self.ndim if isinstance(cells, int) else list(cells)
        if len(counts) != self.ndim:
            raise InputError(f"a robot with {self.ndim} moving joints needs {self.ndim} numbers of cells")
        return tuple(Axis(cells=int(n), **keys) for n, keys in zip(counts, self.implied_axes(), strict=True))

    def implied_axes(self) -> tuple[dict[str, Any], ...]:
        """Return default values of a scene's axis keys (name, lower, upper, periodic, unit), one dict per joint."""
        tree = self.tree
        slides = np.array([bool(tree.is_prismatic[tree.names.index(name)]) for name in tree.moving])
        return tuple(
            {
                "name": "".join(c if c.isascii() and c.isalnum() else "_" for c in name),
                "lower": float(tree.lower[number]),
                "upper": float(tree.upper[number]),
                "periodic": bool(tree.is_continuous[number]),
                "unit": "m" if slides[number] else "rad",
            }
            for number, name in enumerate(tree.moving)
        )

    def axes_on_map(self, axes: Sequence[Axis], headings: int) -> tuple[Axis, ...]:  # noqa: ARG002
        """Raise InputError, because a map of the plane does not define the axes of joints."""
        raise InputError("a robot arm does not move on a map; give it a [grid] for its joints")

    def check_axes(self, axes: Sequence[Axis]) -> None:
        """Raise InputError unless every moving joint has one axis, within the joint's limits, 2 pi long if periodic."""
        if len(axes) != self.ndim:
            raise InputError(f"a robot with {self.ndim} moving joints needs {self.ndim} axes, got {len(axes)}")
        for axis, implied, name in zip(axes, self.implied_axes(), self.moving, strict=True):
            if axis.periodic and not implied["periodic"]:
                raise InputError(f"axis {axis.name!r}: the joint {name!r} has limits; set periodic = false")
            if axis.periodic and abs(axis.upper - axis.lower - tau) > 1e-9:
                raise InputError(
                    f"axis {axis.name!r}: a periodic joint turns by 2 pi, but the axis spans "
                    f"{axis.upper - axis.lower:.15g}; leave lower and upper out, or set periodic = false"
                )
            low, high = implied["lower"], implied["upper"]
            if not implied["periodic"] and (axis.lower < low - 1e-9 or axis.upper > high + 1e-9):
                raise InputError(
                    f"axis {axis.name!r}: the limits of the joint {name!r} are [{low:.10g}, {high:.10g}], but the axis "
                    f"runs from {axis.lower:.10g} to {axis.upper:.10g}; keep it within the limits"
                )

    def parts(self, configurations: NDArray[np.float64]) -> list[RigidPart]:  # noqa: ARG002
        """Raise InputError, because the workspace of the robot is not the plane."""
        raise InputError("the workspace of this robot is space, not the plane")

    def travel(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return upper bounds (n,), in metres, of the distance that any point of the robot moves along straight lines.

        `start, end` (n, m): ends of n lines in configuration space with m moving joints, in radians or metres.
        """
        return np.asarray((np.abs(end - start) @ motion_per_joint(self.tree).T).max(axis=1))

    def tool_poses(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Return poses of the tool in the world (n, 4, 4) for configurations (n, m) of the m moving joints.

        Joint values are in radians or metres, positions in metres (forward kinematics).
        """
        joints = np.atleast_2d(np.asarray(configurations, dtype=np.float64))
        if joints.shape[-1] != self.ndim:
            raise InputError(f"this robot has {self.ndim} moving joints, but a configuration has shape {joints.shape}")
        return tool_poses(self.tree, self.tool_name, joints)

    def reference_point(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions of the tool (n, 3), in metres, for configurations (n, m) of the m moving joints."""
        return self.tool_poses(configurations)[:, :3, 3]

    def bare(self, *, self_collision: bool = True) -> URDFRobot:
        """Return the robot, without self-collision if `self_collision` is False."""
        return self if self_collision or not self.self_collision else replace(self, self_collision=False)

    def among(self, obstacles: Sequence[Shape]) -> KinematicTree:
        """Return joints and bodies of the robot with obstacles (in world coordinates, metres) as further bodies."""
        from resgrid.robots.body import bodies_of
        from resgrid.robots.urdf.model import with_obstacles

        bodies = [body for n, shape in enumerate(obstacles) for body in bodies_of(shape, f"obstacle[{n}]")]
        return with_obstacles(self.tree, bodies, self.mounted)

    def collision_test(self, axes: Sequence[Axis], obstacles: Sequence[Shape]) -> CollisionTest:  # noqa: ARG002
        """Return a test of the robot among obstacles, and with itself, at single configurations, with exact solids."""
        from resgrid.robots.urdf.collision_tests import SolidTest

        for last, test in self._last_test:
            if len(last) == len(obstacles) and all(one is other for one, other in zip(last, obstacles, strict=True)):
                return test
        self._last_test[:] = [(tuple(obstacles), SolidTest(self.among(obstacles)))]
        return self._last_test[0][1]

    @cached_property
    def _last_test(self) -> list[tuple[tuple[Shape, ...], CollisionTest]]:
        """List of the last collision test, as one pair (obstacles, test) for reuse; empty before the first test."""
        return []

    def occupancy(
        self, axes: Sequence[Axis], obstacles: Sequence[Shape], rule: Sampling, progress: Progress | None = None
    ) -> NDArray[np.bool_]:
        """Return the mask of blocked cells, shape of the grid: cells with a collision, and undecided cells.

        `axes`: one axis per moving joint; `obstacles`: shapes in world coordinates, in metres; `rule`:
        ``"conservative"`` (a cell is free only by proof) or ``"centre"`` (only its centre is tested); `progress`:
        called as ``progress(done, total)``.
        """
        return self.classify(axes, obstacles, rule, progress).blocked

    def classify(
        self,
        axes: Sequence[Axis],
        obstacles: Sequence[Shape],
        rule: Sampling,
        progress: Progress | None = None,
        executor: Executor | None = None,
    ) -> CellClasses:
        """Return the blocked cells and, with the rule ``"conservative"``, the undecided cells among them.

        A conservative result is stored in the cache folder (``RESGRID_CACHE``, by default ``~/.cache/resgrid``) under a
        hash of the robot, the obstacles and the axes, and an interrupted computation continues from there.  With the
        rule ``"centre"``, `CellClasses.undecided` is None, and nothing is stored.

        `axes`: axes of the space, one per moving joint; `obstacles`: shapes in world coordinates, in metres; `rule`:
        ``"conservative"`` (a cell is free only by proof) or ``"centre"`` (only its centre is tested); `progress`:
        called as ``progress(done, total)``; `executor`: workers that prove cells, None for this process.
        """
        from resgrid.robots.urdf.cell_blocks import CellVerdict
        from resgrid.robots.urdf.free_cells import centre_cells, proof_key, prove_cells

        self.check_axes(axes)
        tree = self.among(obstacles)
        if rule == "centre":
            return CellClasses(centre_cells(tree, axes, progress))
        key = proof_key(tree, axes, self.halvings)
        verdict = load_array("cells", key)
        if verdict is None:
            with unfinished_file("cells", key) as checkpoint:
                verdict = prove_cells(
                    tree, axes, halvings=self.halvings, executor=executor, progress=progress, checkpoint=checkpoint
                ).verdict
            store_array("cells", key, verdict)
        return CellClasses(verdict != CellVerdict.FREE, verdict == CellVerdict.UNDECIDED)

    def goal_cells(self, axes: Sequence[Axis], region: Shape | Point | ToolGoal) -> GoalCells:
        """Return the cells that contain a configuration with the tool in a region, with one such configuration each.

        `region`: ball, box, half-space or point in the world, or a `ToolGoal` with a rotation.
        """
        self.check_axes(axes)
        goal = region if isinstance(region, ToolGoal) else ToolGoal(region)
        return tool_goal_cells(self.tree, self.tool_name, axes, goal)
