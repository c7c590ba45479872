"""The certificate of a streamline: its promises, checked one by one without the code that traced it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import CertificateError
from resgrid.planning.field import Field
from resgrid.planning.streamline import Outcome, Streamline
from resgrid.space import Cell

_TOLERANCE = 1e-9


def certify(path: Streamline, field: Field) -> None:
    """Check every promise of a streamline.

    For a start that reached a goal: the cells visited are free, all different and face neighbours; every crossing runs
    with the current and lowers the potential (blends: the blended current decides); every point lies on the face
    crossed, so that each segment stays in its convex cell and no corner is cut; the last cell is a goal of the number
    given; the length is that of the polyline.  For the other outcomes: that they are true.

    Parameters
    ----------
    path : Streamline
    field : Field
        The field it was traced in.

    Raises
    ------
    CertificateError
        On the first broken promise; the message names the step.
    """
    cells = np.asarray(path.cells)
    if cells.ndim != 2 or cells.shape[1] != field.space.ndim or not len(cells):
        raise CertificateError(f"cells have shape {cells.shape}, but the space has {field.space.ndim} axes")
    if path.frame != field.space.frame:
        raise CertificateError("the streamline lies elsewhere in the world than the field")
    if np.any(cells < 0) or np.any(cells >= field.space.shape):
        raise CertificateError("the streamline leaves the grid")
    if path.outcome is not Outcome.REACHED:
        _check_failure(path, field, cells)
    if path.outcome in {Outcome.REACHED, Outcome.NO_CURRENT}:
        _check_cells(path, field, cells)
        axis, side = _check_crossings(path, field, cells)
        _check_fall(field, cells)
        _check_points(path, field, cells, axis, side)


def _check_failure(path: Streamline, field: Field, cells: NDArray[np.int64]) -> None:
    start = tuple(cells[0])
    code = field.space.cell[start]
    connected = bool(field.space.goal_connected[start])
    blocked = not field.space.goal_connected.any()
    true = {
        Outcome.START_BLOCKED: code == Cell.OBSTACLE,
        Outcome.NO_PATH: code == Cell.FREE and not connected and not blocked,
        Outcome.GOAL_BLOCKED: code == Cell.FREE and blocked,
        Outcome.NO_CURRENT: connected and not _outward(field, cells[-1]),
    }
    if not true[path.outcome]:
        raise CertificateError(f"the outcome {path.outcome} of the start cell {start} is not true")


def _outward(field: Field, cell: NDArray[np.int64]) -> bool:
    return any(
        side * field.face_direction[axis][_face(cell, axis, side)] > 0
        for axis in range(field.space.ndim)
        for side in (-1, 1)
    )


def _face(cell: NDArray[np.int64], axis: int, side: int) -> tuple[int, ...]:
    face = cell.copy()
    face[axis] += side > 0
    return tuple(face.tolist())


def _check_cells(path: Streamline, field: Field, cells: NDArray[np.int64]) -> None:
    codes = field.space.cell[tuple(cells.T)]
    reached = path.outcome is Outcome.REACHED
    inner = codes[:-1] if reached else codes
    if np.any(inner != Cell.FREE):
        step = int(np.argmax(inner != Cell.FREE))
        raise CertificateError(f"step {step} is in cell {tuple(cells[step])}, which is not free")
    if reached and codes[-1] != Cell.GOAL:
        raise CertificateError(f"the last cell {tuple(cells[-1])} is not a goal cell")
    if reached and path.goal != field.space.goal_region[tuple(cells[-1])]:
        raise CertificateError(f"the last cell belongs to goal {field.space.goal_region[tuple(cells[-1])]}")
    if len(np.unique(cells, axis=0)) < len(cells):
        raise CertificateError("a cell is visited twice")


def _check_crossings(
    path: Streamline, field: Field, cells: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Axis and side of every crossing, each between face neighbours and along the current."""
    local = _local(path, field, cells)
    ways = []
    for number, (here, there) in enumerate(pairwise(cells)):
        changed = np.flatnonzero(here != there)
        axis = int(changed[0]) if len(changed) else 0
        # In a ring of two cells both faces join them: the point says which one was crossed.
        side = 1 if local[number + 1, axis] < 0.5 else -1
        target = here.copy()
        target[axis] += side
        if field.space.axes[axis].periodic:
            target[axis] %= field.space.shape[axis]
        if len(changed) != 1 or not np.array_equal(target, there):
            raise CertificateError(
                f"step {number}: the face crossed from cell {tuple(here)} does not lead to cell {tuple(there)}"
            )
        if not side * field.face_direction[axis][_face(here, axis, side)] > 0:
            raise CertificateError(f"step {number}: no current runs from cell {tuple(here)} to {tuple(there)}")
        ways.append((axis, side))
    axes, sides = np.array(ways, dtype=np.int64).reshape(-1, 2).T
    return axes, sides


def _local(path: Streamline, field: Field, cells: NDArray[np.int64]) -> NDArray[np.float64]:
    """Position of every point within its cell, in [0, 1]."""
    if path.axis_points.shape != cells.shape:
        raise CertificateError(f"points of shape {path.axis_points.shape} for cells of shape {cells.shape}")
    return np.asarray((path.axis_points - field.space.lower) / field.space.spacing - cells)


def _check_fall(field: Field, cells: NDArray[np.int64]) -> None:
    if field.boundary == "blend":
        return
    at = tuple(cells.T)
    height = -field.log_drop[at] if field.log_drop is not None else field.potential[at]
    rises = np.diff(height)
    # Where the two nodes are equal in float64 the current, known to more digits, has already decided.
    if np.any(rises > 0) or np.any(np.isnan(rises)):
        step = int(np.argmax(~(rises <= 0)))
        raise CertificateError(f"step {step}: the potential rises from cell {tuple(cells[step])} to the next")


def _check_points(
    path: Streamline, field: Field, cells: NDArray[np.int64], axis: NDArray[np.int64], side: NDArray[np.int64]
) -> None:
    space = field.space
    local = _local(path, field, cells)
    if np.any(local < -_TOLERANCE) or np.any(local > 1 + _TOLERANCE):
        step = int(np.argmax(np.any((local < -_TOLERANCE) | (local > 1 + _TOLERANCE), axis=1)))
        raise CertificateError(f"point {step} lies outside its cell {tuple(cells[step])}")
    number = np.arange(1, len(cells))
    entered = np.where(side > 0, 0.0, 1.0)
    if len(axis) and np.any(np.abs(local[number, axis] - entered) > _TOLERANCE):
        raise CertificateError("a crossing does not lie on the face between its two cells")
    left = local[1:].copy()
    left[np.arange(len(axis)), axis] = np.where(side > 0, 1.0, 0.0)
    length = float(np.linalg.norm((left - local[:-1]) * space.spacing, axis=1).sum())
    if abs(length - path.length) > _TOLERANCE * (1.0 + length):
        raise CertificateError(f"the length is {length}, not {path.length}")
