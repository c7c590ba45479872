"""Forward kinematics of a tool, and inverse kinematics: the cells with a configuration that solves a goal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen
from resgrid.core.axis import Axis, Point
from resgrid.errors import InputError
from resgrid.robots.cells import GoalCells
from resgrid.robots.shapes import Ball, Box, HalfSpace, Shape
from resgrid.robots.urdf.tree import KinematicTree

_TOLERANCE = 1e-9
"""Tolerance of a goal: distance from the region in metres, and angle beyond the permitted one in radians.

A configuration within both tolerances is a solution.
"""

_NEWTON_STEPS = 24
"""Largest number of Gauss-Newton steps of the search for a solution from the centre of a box of configurations."""

_DAMPING = 1e-12
"""Levenberg-Marquardt damping, the number added to the diagonal of the normal equations, relative to their trace."""

_HALVINGS = 48
"""Number of halvings of a cell that is never reached; a box without a solution that needs this many is given up.

The tool then stays within about 1e-9 m of the border of the region in the whole box.
"""

_MAX_BOXES = 1 << 20
"""Largest number of boxes that are searched together, to limit memory; with more, the cells are searched in two halves.

A cell that needs more boxes alone is not searched further and is no goal cell.
"""


@frozen
@dataclass(frozen=True, eq=False)
class ToolGoal:
    """A set of poses of a tool: its origin in a region, and its frame within an angle of a given rotation.

    Attributes
    ----------
    region : Ball, Box, HalfSpace or tuple of float
        Region of the tool's origin, or a single point, in world coordinates, in metres.
    rotation : ndarray of float64, shape (3, 3), or None
        Wanted rotation matrix of the tool's frame in the world; None permits all rotations.
    angle : float
        Largest angle in radians between the tool's frame and `rotation`; not used without `rotation`.
    """

    region: Shape | Point
    rotation: NDArray[np.float64] | None = None
    angle: float = 0.0

    def nearest(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the points of the region (n, 3) that are nearest to `points` (n, 3), in metres."""
        match self.region:
            case tuple():
                return np.broadcast_to(np.asarray(self.region, dtype=np.float64), points.shape)
            case Box(lower, upper):
                return np.clip(points, lower, upper)
            case Ball(centre, radius):
                away = points - centre
                distance = np.linalg.norm(away, axis=1, keepdims=True)
                return np.asarray(centre + away * np.minimum(1.0, radius / np.maximum(distance, 1e-300)))
            case HalfSpace(normal, offset):
                size = float(np.linalg.norm(normal))
                above = (points @ np.array(normal) - offset) / size
                return np.asarray(points - np.maximum(above, 0.0)[:, np.newaxis] * (np.array(normal) / size))
        raise InputError(f"a goal of a tool is a ball, a box, a half-space or a point, not {self.region!r}")


@dataclass(frozen=True, eq=False)
class _Tool:
    """A tool of a robot.

    `tree`: joints and bodies of the robot; `joint`: index of the joint whose frame carries the tool; `pose` (4, 4): the
    tool's pose in this frame; `chain`: indices of the joints from the base to `joint`.
    """

    tree: KinematicTree
    joint: int
    pose: NDArray[np.float64]
    chain: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class _Boxes:
    """Boxes of configurations that may contain a solution.

    `centre`, `half` (n, m): centres, and half the widths, in radians or metres; `owner` (n,): row, in the searched
    batch of cells, of the cell that contains each box; `halvings`: number of halvings of a cell that gave these boxes.
    """

    centre: NDArray[np.float64]
    half: NDArray[np.float64]
    owner: NDArray[np.int64]
    halvings: int

    def of(self, chosen: NDArray[np.bool_]) -> _Boxes:
        """Return the boxes for which the mask `chosen` (n,) is True."""
        return _Boxes(self.centre[chosen], self.half[chosen], self.owner[chosen], self.halvings)

    def halved(self, gain: NDArray[np.float64]) -> _Boxes:
        """Return both halves of every box, cut along the joint with the largest effect `gain` (n, m) on the tool."""
        row, joint = np.arange(len(self.centre)), np.argmax(gain, axis=1)
        half = self.half.copy()
        half[row, joint] /= 2
        step = np.zeros_like(half)
        step[row, joint] = half[row, joint]
        centre = np.concatenate([self.centre - step, self.centre + step])
        return _Boxes(centre, np.tile(half, (2, 1)), np.tile(self.owner, 2), self.halvings + 1)

    def parts(self) -> list[_Boxes]:
        """Return parts with at most `_MAX_BOXES` boxes each, which keep all boxes of a cell together.

        A cell that has more boxes alone is left out.
        """
        if len(self.owner) <= _MAX_BOXES:
            return [self]
        cells = np.unique(self.owner)
        if len(cells) == 1:
            return []
        lower = self.owner < cells[len(cells) // 2]
        return [*self.of(~lower).parts(), *self.of(lower).parts()]


def tool_poses(tree: KinematicTree, tool: str, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return poses of a tool in the world (n, 4, 4) for configurations (n, m) in radians or metres.

    `tree`: joints of the robot, of which m move; `tool`: name of a link of the robot.
    """
    joint, pose = tree.tools[tool]
    if joint < 0:
        return np.broadcast_to(pose, (len(configurations), 4, 4))
    return np.asarray(tree.frames(configurations)[:, joint] @ pose)


def tool_goal_cells(tree: KinematicTree, tool: str, axes: Sequence[Axis], goal: ToolGoal) -> GoalCells:
    """Return the cells that contain a configuration with the tool in a goal, and one such configuration per cell.

    A cell is excluded only by bounds on the motion of the tool within it, so that every inverse-kinematics solution
    lies in a goal cell.  Exceptions are cells in which the tool stays within 1e-9 m of the border of the goal without
    entering it, to within rounding errors, and cells in which more than `_MAX_BOXES` boxes stay undecided.
    `tool`: name of a link; `axes`: axes of the configuration space, one per moving joint.  Raise InputError, with the
    smallest distance or excess angle that was found, if there is no goal cell.
    """
    searched = _tool_of(tree, tool)
    shape = tuple(axis.cells for axis in axes)
    lower, spacing = np.array([(axis.lower, axis.spacing) for axis in axes]).T
    found = np.zeros(shape, dtype=np.bool_)
    points = np.zeros((prod(shape), len(axes)))
    nearest = np.inf
    for cells in _possible_cells(searched, shape, lower, spacing, goal):
        flat, solutions, gap = _solve_cells(searched, cells, lower, spacing, goal)
        owners = np.ravel_multi_index(tuple(cells[flat].T), shape)
        found.reshape(-1)[owners] = True
        points[owners] = solutions
        nearest = min(nearest, gap)
    if not found.any():
        raise InputError(_why_unreachable(searched, lower, spacing, shape, goal, nearest))
    return GoalCells(found, points[found.reshape(-1)])


def _tool_of(tree: KinematicTree, name: str) -> _Tool:
    joint, pose = tree.tools[name]
    chain, at = [], joint
    while at >= 0:
        chain.append(at)
        at = int(tree.parent[at])
    if not chain:
        raise InputError(f"the tool {name!r} does not move with any moving joint; choose another tool or moving joint")
    return _Tool(tree, joint, pose, tuple(reversed(chain)))


def _possible_cells(
    tool: _Tool, shape: tuple[int, ...], lower: NDArray[np.float64], spacing: NDArray[np.float64], goal: ToolGoal
) -> Iterator[NDArray[np.int64]]:
    """Yield batches of the cells (n, m) that no bound excludes, as cell indices.

    A bound excludes cells if the largest motion of the tool within them, from their centre, is too small to reach the
    goal.  Blocks of cells are halved along the joint that moves the tool most, until they are excluded or single cells.
    `shape`: cells per axis; `lower`, `spacing` (m,): lower ends of the axes and widths of their cells.
    """
    stack = [(np.zeros((1, len(shape)), dtype=np.int64), np.array([shape], dtype=np.int64))]
    while stack:
        first, last = stack.pop()
        centre, half = lower + (first + last) / 2 * spacing, (last - first) / 2 * spacing
        keep, gain = _possible(tool, centre, half, goal)
        first, last, gain = first[keep], last[keep], gain[keep]
        single = (last - first == 1).all(1)
        if single.any():
            yield first[single]
        first, last, gain = first[~single], last[~single], gain[~single]
        if not len(first):
            continue
        joint = np.argmax(np.where(last - first > 1, gain, -1.0), axis=1)
        row = np.arange(len(first))
        middle = (first[row, joint] + last[row, joint]) // 2
        left_last, right_first = last.copy(), first.copy()
        left_last[row, joint] = right_first[row, joint] = middle
        firsts, lasts = np.concatenate([first, right_first]), np.concatenate([left_last, last])
        stack += [(firsts[i : i + 4096], lasts[i : i + 4096]) for i in range(0, len(firsts), 4096)]


def _solve_cells(
    tool: _Tool, cells: NDArray[np.int64], lower: NDArray[np.float64], spacing: NDArray[np.float64], goal: ToolGoal
) -> tuple[NDArray[np.int64], NDArray[np.float64], float]:
    """Return the rows (s,) of `cells` that contain a solution, one solution (s, m) for each, and a distance.

    The distance, in metres, is the smallest one between tool and region that the search found, for messages. `tool`:
    tool of the robot; `goal`: its poses in the goal; `cells` (n, m): cell indices; `lower`, `spacing` (m,): lower ends
    of the axes and widths of their cells.
    """
    low, high = lower + cells * spacing, lower + (cells + 1) * spacing
    solution = np.full(low.shape, np.nan)
    nearest = np.inf
    stack = [_Boxes((low + high) / 2, (high - low) / 2, np.arange(len(cells)), 0)]
    while stack:
        boxes = stack.pop()
        end = _gauss_newton(tool, boxes.centre, boxes.centre - boxes.half, boxes.centre + boxes.half, goal)
        distance, angle = _violations(tool, end, goal)
        nearest = min(nearest, float(distance.min(initial=np.inf)))
        solved = (distance <= _TOLERANCE) & (angle <= _TOLERANCE)
        owner = boxes.owner[solved]
        solution[owner] = np.clip(end[solved], low[owner], high[owner])
        keep, gain = _possible(tool, boxes.centre, boxes.half, goal)
        keep &= np.isnan(solution[boxes.owner, 0])
        if keep.any() and boxes.halvings + 1 < _HALVINGS:
            stack += boxes.of(keep).halved(gain[keep]).parts()
    solved_cells = np.flatnonzero(~np.isnan(solution[:, 0]))
    return solved_cells, solution[solved_cells], nearest


def _possible(
    tool: _Tool, centre: NDArray[np.float64], half: NDArray[np.float64], goal: ToolGoal
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Return whether n boxes of configurations may contain a solution, (n,), and the effect of every joint, (n, m).

    The effect is a bound on the tool's motion by the joint within the box in metres, plus that on its rotation in
    radians.  `centre`, `half` (n, m): centres of the boxes, and half their widths, in radians or metres.

    The joints may turn one after the other from the base on, because all that lies beyond a turning joint is then still
    as rigid as at the centre.  Joint j moves the tool by at most its lever rho_j (the distance from the joint's axis)
    times its rotation e_j.  A second bound uses the direction n from the nearest point of the region, which is convex:
    the component of the motion along n is at most e_j |n . (axis_j x r_j)|, plus rho_j e_j (e_j / 2 + e_1 + ... +
    e_(j-1)) for the curvature of the path and for the rotation by the joints before.
    """
    tree, frames = tool.tree, tool.tree.frames(centre)
    pose = frames[:, tool.joint] @ tool.pose
    away = pose[:, :3, 3] - goal.nearest(pose[:, :3, 3])
    distance = np.linalg.norm(away, axis=1)
    away /= np.maximum(distance, 1e-300)[:, np.newaxis]
    gain, along = np.zeros_like(centre), np.zeros_like(centre)
    travel, curved, turned = np.zeros(len(centre)), np.zeros(len(centre)), np.zeros(len(centre))
    for joint in tool.chain:
        driver = tree.driver[joint]
        axis = frames[:, joint, :3, :3] @ tree.direction[joint]
        moves = np.abs(tree.factor[joint]) * half[:, driver]
        is_prismatic = tree.is_prismatic[joint]
        motion = axis if is_prismatic else np.cross(axis, pose[:, :3, 3] - frames[:, joint, :3, 3])
        lever = np.linalg.norm(motion, axis=1)
        along[:, driver] += tree.factor[joint] * np.einsum("ni,ni->n", motion, away)
        travel += lever * moves
        curved += lever * moves * (turned + (0.0 if is_prismatic else moves / 2))
        gain[:, driver] += lever * moves
        if not is_prismatic:
            turned += moves
            gain[:, driver] += moves
    directed = (np.abs(along) * half).sum(axis=1) + curved
    possible = distance <= np.minimum(travel, directed) + _TOLERANCE
    if goal.rotation is not None:
        angle = np.linalg.norm(_rotation_vectors(pose[:, :3, :3], goal.rotation), axis=1)
        possible &= angle <= goal.angle + turned + _TOLERANCE
    return possible, gain


def _violations(
    tool: _Tool, configurations: NDArray[np.float64], goal: ToolGoal
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distances (n,), in metres, of the tool from a goal's region, and the excess angles (n,), in radians.

    The excess angle is the part of the angle from the wanted rotation beyond the permitted angle; both are 0 inside the
    goal.  `configurations` (n, m): values of the m moving joints, in radians or metres.
    """
    pose = tool.tree.frames(configurations)[:, tool.joint] @ tool.pose
    distance = np.linalg.norm(pose[:, :3, 3] - goal.nearest(pose[:, :3, 3]), axis=1)
    if goal.rotation is None:
        return distance, np.zeros(len(distance))
    angle = np.linalg.norm(_rotation_vectors(pose[:, :3, :3], goal.rotation), axis=1)
    return distance, np.maximum(angle - goal.angle, 0.0)


def _rotation_vectors(rotations: NDArray[np.float64], wanted: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation vectors (n, 3), in radians in the world, from `wanted` (3, 3) to `rotations` (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotations @ wanted.T).as_rotvec())


def _gauss_newton(
    tool: _Tool,
    start: NDArray[np.float64],
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    goal: ToolGoal,
) -> NDArray[np.float64]:
    """Return configurations (n, m) near the goal, by damped Gauss-Newton steps from `start`, within boxes of joints.

    `start`, `lower`, `upper` (n, m): first configurations, and corners of the boxes, in radians or metres.
    """
    configurations = start.copy()
    for _ in range(_NEWTON_STEPS):
        residual, jacobian = _linearized(tool, configurations, goal)
        if not residual.size or np.abs(residual).max() <= _TOLERANCE / 10:
            break
        transposed = jacobian.transpose(0, 2, 1)
        normal = transposed @ jacobian
        damping = _DAMPING * np.trace(normal, axis1=1, axis2=2) + 1e-30
        normal += damping[:, np.newaxis, np.newaxis] * np.eye(start.shape[1])
        step = np.linalg.solve(normal, transposed @ residual[..., np.newaxis])[..., 0]
        configurations = np.clip(configurations - np.clip(step, lower - upper, upper - lower), lower, upper)
    return configurations


def _linearized(
    tool: _Tool, configurations: NDArray[np.float64], goal: ToolGoal
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return residuals (n, 3 or 6) of a goal and their Jacobians (n, 3 or 6, m), in metres and radians per joint unit.

    The residuals are the vector from the region to the tool and, for a goal with a rotation, the part of the rotation
    vector beyond the permitted angle.  `configurations` (n, m): values of the m moving joints.
    """
    tree = tool.tree
    frames = tree.frames(configurations)
    pose = frames[:, tool.joint] @ tool.pose
    point = pose[:, :3, 3]
    residual = point - goal.nearest(point)
    jacobian = np.zeros((len(point), 6, configurations.shape[1]))
    for joint in tool.chain:
        axis = (frames[:, joint, :3, :3] @ tree.direction[joint]) * tree.factor[joint]
        if tree.is_prismatic[joint]:
            jacobian[:, :3, tree.driver[joint]] += axis
        else:
            jacobian[:, :3, tree.driver[joint]] += np.cross(axis, point - frames[:, joint, :3, 3])
            jacobian[:, 3:, tree.driver[joint]] += axis
    if goal.rotation is None:
        return residual, jacobian[:, :3]
    vector = _rotation_vectors(pose[:, :3, :3], goal.rotation)
    angle = np.linalg.norm(vector, axis=1, keepdims=True)
    excess = vector * (np.maximum(angle - goal.angle, 0.0) / np.maximum(angle, 1e-300))
    return np.concatenate([residual, excess], axis=1), jacobian


def _why_unreachable(
    tool: _Tool,
    lower: NDArray[np.float64],
    spacing: NDArray[np.float64],
    shape: tuple[int, ...],
    goal: ToolGoal,
    nearest: float,
) -> str:
    """Return the message for a goal without a solution, with the smallest distance or excess angle that was found.

    `lower`, `spacing` (m,): lower ends of the axes and widths of their cells; `shape`: cells per axis; `nearest`:
    smallest distance that the search found, in metres.
    """
    from scipy.optimize import least_squares

    place, low, high = ToolGoal(goal.region), lower, lower + spacing * shape

    def offset(configuration: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(_linearized(tool, configuration[np.newaxis], place)[0][0])

    sample = np.random.default_rng(0).uniform(low, high, (4096, len(shape)))
    best = sample[np.argsort(_violations(tool, sample, place)[0])[:16]]
    ends = np.array([least_squares(offset, start, bounds=(low, high)).x for start in best])
    distance, angle = _violations(tool, ends, goal)
    smallest = min(nearest, float(distance.min()))
    if smallest > _TOLERANCE:
        return (
            "no configuration of the moving joints brings the tool into this goal; the closest one leaves "
            f"{smallest:.3g} m; move or enlarge the goal, or choose other moving joints"
        )
    angle = angle[distance <= _TOLERANCE]
    closest = f": the closest one is off by {angle.min():.3g} rad more than the permitted angle" if angle.size else ""
    return (
        f"no configuration brings the tool into this goal with the wanted rotation{closest}; turn the goal, or permit "
        "a larger angle"
    )
