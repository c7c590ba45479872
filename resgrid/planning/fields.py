"""The field of a configuration space: a potential in every cell and a current through every cell face."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen, picture_html
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.compiler import CellRole, contacts_of_box
from resgrid.core.netlist import CellMap
from resgrid.core.regions import by_axis, cells_at_faces, face_counts, face_shape, with_margin
from resgrid.core.space import Cell, ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.errors import AccuracyError, CircuitError, InputError
from resgrid.planning.clearance import obstacle_reach
from resgrid.planning.kcl_check import between_rails, face_currents, obeys_kcl, safe_cells

if TYPE_CHECKING:
    from resgrid.circuit.warm_start import WarmPoint
    from resgrid.planning.kernels import Flow


@frozen
@dataclass(frozen=True, eq=False)
class Field:
    """Potential and face currents on a configuration space.

    Attributes
    ----------
    space : ConfigurationSpace
        The space.
    wiring : Wiring
        Of the circuit it was read off; of a blend, of that of k = 1.
    potential : ndarray of float64, shape of the space
        ``phi``: 1 on obstacles, 0 on goals; NaN in a cell without a node.  With a uniform drive it is the height above
        the goal rail, scaled to a maximum of 1.
    log_drop : ndarray of float64, shape of the space, or None
        Natural logarithm of ``u = 1 - phi``, right to some 1e-8 (``OperatingPoint.entry_error``) even where ``phi``
        rounds to 1; -inf where nothing arrives, NaN in a cell without a node.  None where no high rail exists (uniform
        drive, blends).
    face_direction : tuple of ndarray of int8
        Per axis ``a``, shape of the space with one more along ``a``: the sign of the current through the lower face of
        every cell, positive in the direction of the axis, 0 where none flows.  It runs from high potential to low.  On
        a periodic axis the last face repeats the first.
    face_log_current : tuple of ndarray of float64
        Same shapes: natural logarithm of its magnitude in units of supply / resistance, for the potential as scaled;
        -inf where none flows.
    k : float
        Share of the Dirichlet field: 1 for Dirichlet and walls, 0 for Neumann.
    safe : ndarray of bool, shape of the space, or None
        Free cells in which the field is direction-safe; streamlines end at all others with ``no_current``.  None where
        the field is direction-safe as a whole, as all are but those of ``method="petsc"``, of warm starts and of
        ``accuracy="normwise"``.

    Examples
    --------
    >>> field = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).field
    >>> field.potential[5, :4].round(3)
    array([0.784, 0.585, 0.718, 0.843])
    >>> field.log_drop[5, :4].round(2)
    array([-1.53, -0.88, -1.27, -1.85])
    >>> field.face_current(0)[5:8, 1].round(3)
    array([ 0.253,  0.585, -0.65 ])
    """

    space: ConfigurationSpace
    wiring: Wiring
    potential: NDArray[np.float64]
    log_drop: NDArray[np.float64] | None
    face_direction: tuple[NDArray[np.int8], ...]
    face_log_current: tuple[NDArray[np.float64], ...]
    k: float
    safe: NDArray[np.bool_] | None = None

    def __repr__(self) -> str:
        cells = " x ".join(map(str, self.space.shape))
        drive = f", driven by {self.wiring.drive}" if self.wiring.drive else ""
        return f"<Field on {cells} cells: {self.boundary}{drive}, k = {self.k:g}>"

    _repr_html_ = picture_html

    @property
    def boundary(self) -> str:
        """What obstacles are: ``"dirichlet"``, ``"neumann"``, ``"wall"`` or ``"blend"``."""
        return "blend" if 0.0 < self.k < 1.0 else self.wiring.boundary

    @property
    def edge(self) -> tuple[str, ...]:
        """What the border of the grid is, per axis: ``"periodic"``, ``"obstacle"`` or ``"open"``."""
        return self.wiring.edges(self.space)

    @property
    def is_flowing(self) -> bool:
        """Whether any current flows."""
        return any(direction.any() for direction in self.face_direction)

    def __getstate__(self) -> dict[str, Any]:
        return {attribute.name: getattr(self, attribute.name) for attribute in dataclasses.fields(self)}

    def face_current(self, axis: int) -> NDArray[np.float64]:
        """Current through every face across an axis, as `face_direction`; in units of supply / resistance."""
        return np.asarray(self.face_direction[axis] * np.exp(self.face_log_current[axis]), dtype=np.float64)

    def faces_of(self, cells: NDArray[np.int64]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        """Directions and log currents of every axis' lower and upper face, both (2, n, ndim), of cells (n, ndim)."""
        direction = np.empty((2, *cells.shape), dtype=np.int8)
        log_current = np.empty((2, *cells.shape))
        for axis in range(self.space.ndim):
            for side in (0, 1):
                face = cells.copy()
                face[:, axis] += side
                direction[side, :, axis] = self.face_direction[axis][tuple(face.T)]
                log_current[side, :, axis] = self.face_log_current[axis][tuple(face.T)]
        return direction, log_current

    def gradient(
        self, cells: NDArray[np.int64], local: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Gradient of the potential within cells, divided by a number for each, and the logarithm of that number.

        The current through a face of axis ``a`` is ``(h_ref / h_a)**2`` times the difference of the potential, and runs
        downwards: the gradient is the current times ``h_a``, up to a common factor, and linear between the faces.
        Shapes: `cells, local` (n, ndim); returns (n, ndim), (n,).
        """
        direction, log_current = self.faces_of(cells)
        largest = log_current.max(axis=(0, 2))
        base = np.where(np.isfinite(largest), largest, 0.0)
        lower, upper = direction * np.exp(log_current - base[:, np.newaxis])
        return -((1.0 - local) * lower + local * upper) * self.space.spacing, base

    @cached_property
    def obstacle_reach(self) -> NDArray[np.float64] | None:
        """As `resgrid.planning.clearance.obstacle_reach`."""
        return obstacle_reach(self.space)

    @cached_property
    def flow(self) -> Flow:
        """The field in flat arrays, as the tracing kernels take it."""
        from resgrid.planning.kernels import Flow

        space = self.space
        shapes = [face_shape(space.shape, axis) for axis in range(space.ndim)]
        return Flow(
            code=_ends(space, self.safe),
            shape=np.array(space.shape, dtype=np.int64),
            spacing=space.spacing,
            first_face=np.cumsum([0, *face_counts(space.shape)[:-1]], dtype=np.int64),
            face_stride=np.array([np.cumprod([1, *shape[:0:-1]])[::-1] for shape in shapes], dtype=np.int64),
            direction=_joined(self.face_direction),
            log_current=_joined(self.face_log_current),
        )


def _ends(space: ConfigurationSpace, safe: NDArray[np.bool_] | None) -> NDArray[np.uint8]:
    """The cells' codes, flat, with goals where streamlines end: there, and where no direction can be told."""
    if safe is None:
        return space.cell.ravel()
    return np.where((space.cell == Cell.FREE) & ~safe, np.uint8(Cell.GOAL), space.cell).ravel()


def _joined(parts: tuple[NDArray[Any], ...]) -> NDArray[Any]:
    """All of them, flat, one behind the other: the array they are views of, if they are, or a copy."""
    whole = parts[0].base
    if isinstance(whole, np.ndarray) and whole.ndim == 1 and whole.size == sum(part.size for part in parts):
        ends = np.cumsum([0, *(part.nbytes for part in parts)]) + whole.ctypes.data
        if all(part.flags.c_contiguous and part.ctypes.data == at for part, at in zip(parts, ends, strict=False)):
            return whole
    return np.concatenate([part.ravel() for part in parts])


def field(op: OperatingPoint | WarmPoint) -> Field:
    """Read the field of a configuration space off the operating point of its netlist.

    Parameters
    ----------
    op : OperatingPoint or WarmPoint
        Of a netlist with a map of cells; or what a warm start found, whose netlist is not compiled for this, and whose
        cells without a way to a goal may have no potential.

    Returns
    -------
    Field

    Raises
    ------
    InputError
        If the netlist was not compiled from a space, or has neither two rails nor one rail and a drive.
    CircuitError
        If no current flows through any free cell.
    AccuracyError
        If the chip's switches or rails are so poor that current leaves free cells into obstacles; it carries the field.

    Examples
    --------
    >>> space = rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))
    >>> field = rg.field(rg.solve(rg.compile_space(space)))
    >>> field
    <Field on 8 x 8 cells: dirichlet, k = 1>
    >>> field.potential[6].round(3)
    array([0.652, 0.   , 0.574, 0.801, 0.908, 0.963, 1.   , 0.998])
    """
    if not isinstance(op, OperatingPoint):
        from resgrid.circuit.warm_start import WarmPoint

        if not isinstance(op, WarmPoint):
            raise InputError(f"op = {op!r} must be an OperatingPoint (rg.solve(netlist)), or a solution of a WarmStart")
        return read_cells(op.space, op.wiring, op.voltage)
    cells = op.netlist.cells
    if op.potential is None or op.method == "none":
        _check_driven(op, cells)
    if op.potential is None:
        raise InputError("this circuit has more rails or drives than a field is defined for")
    volts = cells.wiring.supply
    if cells.wiring.drive == "uniform":
        volts = float(op.voltage[np.nanargmax(op.potential)] - cells.wiring.goal_voltage)
    result = read_field(
        cells,
        volts,
        op.potential,
        op.log_drop,
        (cells.resistor_face, cells.resistor_upward, op.resistor_direction, op.resistor_log_current),
        (cells.nonlinear_face, cells.nonlinear_upward, op.nonlinear_direction, op.nonlinear_log_amps),
    )
    if np.any(cells.resistor_face < 0):
        _check_walls(result)
    safe = safe_cells(op)
    return result if safe is None else replace(result, safe=safe)


Elements = tuple[NDArray[np.integer[Any]], NDArray[np.bool_], NDArray[np.int8], NDArray[np.float64]]
"""Faces that elements cross (-1 for none), whether upwards, and the directions and log amperes of their currents."""


def read_field(
    cells: CellMap,
    volts: float,
    potential: NDArray[np.float64],
    log_drop: NDArray[np.float64] | None,
    *elements: Elements,
) -> Field:
    """Spread what nodes (n,) and elements show over cells and faces; ``volts`` lie between potential 0 and 1."""
    space = cells.space
    faces = sum(face_counts(space.shape))
    direction, log_current = np.zeros(faces, dtype=np.int8), np.full(faces, -np.inf)
    for face, upward, sign, log_amps in elements:
        crosses = face >= 0
        along = np.where(upward, 1, -1) * int(np.sign(volts))
        direction[face[crosses]] = (sign * along)[crosses]
        log_current[face[crosses]] = log_amps[crosses] - np.log(abs(volts) / cells.wiring.resistance)
    return Field(
        space=space,
        wiring=cells.wiring,
        potential=_per_cell(cells, potential),
        log_drop=None if log_drop is None else _per_cell(cells, log_drop),
        face_direction=_closed(by_axis(direction, space.shape), space),
        face_log_current=_closed(by_axis(log_current, space.shape), space),
        k=0.0 if cells.wiring.is_driven else 1.0,
    )


def read_cells(space: ConfigurationSpace, wiring: Wiring, voltage: NDArray[np.float64], *, check: bool = True) -> Field:
    """Spread voltages of cells, shape of the space, over cells and faces; as they are, with no bound of their error."""
    at_goal = (space.cell == Cell.GOAL) | (space.goal_connected & np.isnan(voltage))
    volts = np.where(at_goal, wiring.goal_voltage, voltage)
    volts[space.cell == Cell.OBSTACLE] = np.nan if wiring.is_driven else wiring.high
    if wiring.start is not None:
        volts[wiring.start] = wiring.high
    height = (volts - wiring.goal_voltage) * np.sign(wiring.supply)
    unit = np.nanmax(height) if wiring.drive == "uniform" else abs(wiring.supply)
    contacts = contacts_of_box(space, wiring.on(space))
    wide = with_margin(volts, space.periodic)
    wide[contacts.kind == CellRole.HIGH] = wiring.high
    currents = face_currents(contacts.conductance, np.sign(wiring.supply) * wide)
    if not unit > 0.0 or not any(current.any() for current in currents):
        raise CircuitError("nothing is driven: no current flows between the goal and what is at another voltage")
    safe = None
    if check:
        fed = np.count_nonzero(space.goal_connected) if wiring.drive == "uniform" else 0
        injected = abs(wiring.supply) / (wiring.resistance * fed) if fed else 0.0
        safe = (space.cell == Cell.FREE) & between_rails(height, wiring)
        safe &= obeys_kcl(contacts.conductance, wide, currents, injected)
        if wiring.start is not None:
            safe[wiring.start] = any(current.any() for current in currents)
    with np.errstate(divide="ignore"):
        log_current = tuple(np.log(np.abs(current) * (wiring.resistance / unit)) for current in currents)
    return Field(
        space=space,
        wiring=wiring,
        potential=height / unit,
        log_drop=None,
        face_direction=tuple(np.sign(current).astype(np.int8) for current in currents),
        face_log_current=log_current,
        k=0.0 if wiring.is_driven else 1.0,
        safe=safe,
    )


def _closed(faces: tuple[NDArray[Any], ...], space: ConfigurationSpace) -> tuple[NDArray[Any], ...]:
    """The same arrays of faces; on a periodic axis the last face now repeats the first."""
    for axis in np.flatnonzero(space.periodic).tolist():
        along = np.moveaxis(faces[axis], axis, 0)
        along[-1] = along[0]
    return faces


def undriven_field(space: ConfigurationSpace, wiring: Wiring) -> Field:
    """The field of a circuit in which nothing flows.

    Cells with a way to a goal are at the goal's voltage, and obstacles on a rail at the rail's.
    """
    faces = sum(face_counts(space.shape))
    potential = np.where(space.goal_connected | (space.cell == Cell.GOAL), 0.0, np.nan)
    if not wiring.is_driven:
        potential[space.cell == Cell.OBSTACLE] = 1.0
    return Field(
        space=space,
        wiring=wiring,
        potential=potential,
        log_drop=None,
        face_direction=by_axis(np.zeros(faces, dtype=np.int8), space.shape),
        face_log_current=by_axis(np.full(faces, -np.inf), space.shape),
        k=0.0 if wiring.is_driven else 1.0,
    )


def _check_driven(op: OperatingPoint, cell_map: CellMap) -> None:
    """Refuse a circuit whose sources feed each other alone, as where goals beside obstacles are rails cell by cell."""
    free = np.zeros(op.netlist.node_count, dtype=np.bool_)
    free[cell_map.free_node] = True
    if not op.resistor_current[free[op.netlist.resistor_nodes].any(axis=1)].any():
        raise CircuitError(
            "nothing is driven: no free cell lies between the goal and an obstacle, so that all of them are at one "
            "voltage; move the goal, or open a way to it"
        )


def _check_walls(field: Field) -> None:
    """Refuse a chip that is not ideal, and where a streamline from a start with a path would enter an obstacle."""
    space = field.space
    free = with_margin(space.goal_connected, space.periodic, beyond=False)
    solid = with_margin(space.cell == Cell.OBSTACLE, space.periodic, beyond=True)
    for axis, direction in enumerate(field.face_direction):
        (here, there), (before, behind) = cells_at_faces(free, axis), cells_at_faces(solid, axis)
        enters = (here & behind & (direction > 0)) | (before & there & (direction < 0))
        if enters.any():
            face = np.argwhere(enters)[0]
            face[axis] -= here[tuple(face)]
            cell = tuple(np.mod(face, space.shape).tolist())
            raise AccuracyError(
                f"{int(enters.sum())} walls of this chip draw current out of free cells (such as {cell}), so that "
                "streamlines would enter obstacles: its switches or rails sag too much; give them less resistance",
                field,
            )


def _per_cell(cell_map: CellMap, value: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(cell_map.node >= 0, value[cell_map.node], np.nan)
