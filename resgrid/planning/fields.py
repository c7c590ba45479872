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
from resgrid.core.cell import Cell
from resgrid.core.cell_map import CellMap
from resgrid.core.compiler import CellRole, contacts_of_box
from resgrid.core.regions import by_axis, cells_at_faces, face_counts, face_shape, with_margin
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.errors import AccuracyError, CircuitError, InputError
from resgrid.planning.clearance import obstacle_reach
from resgrid.planning.kcl_check import between_rails, face_currents, leak_currents, obeys_kcl, safe_cells

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
        Wiring of the solved circuit; for a blend, wiring of the circuit of k = 1.
    potential : ndarray of float64, shape of the space
        ``phi``: 1 on obstacles that are connected to a rail, 0 on goals; NaN in a cell without a node, such as an open
        obstacle.  With a uniform drive, the height above the goal rail, scaled to a maximum of 1.
    log_drop : ndarray of float64, shape of the space, or None
        Natural logarithm of the drop ``u = 1 - phi``, with an error of about 1e-8 (``OperatingPoint.entry_error``) even
        where ``phi`` rounds to 1; -inf in cells without a path to a goal, NaN in a cell without a node.  None if the
        circuit has no high rail (uniform drive), and for blends.
    face_direction : tuple of ndarray of int8
        Sign of the current through the lower face of every cell, 0 without current.  One array per axis ``a``, with
        the shape of the space plus one along ``a``.  Positive currents flow in the direction of the axis, from high
        potential to low.  On a periodic axis the last face repeats the first.
    face_log_current : tuple of ndarray of float64
        Natural logarithm of the current's magnitude, in units of supply / resistance and for the potential as scaled;
        -inf without current.  Shapes of `face_direction`.
    k : float
        Weight of the Dirichlet field: 1 for Dirichlet and walls, 0 for Neumann.
    safe : ndarray of bool, shape of the space, or None
        Free cells in which the field is direction-safe; streamlines end at all other cells with ``no_current``.  None
        if all are, as always except with ``method="petsc"``, warm starts and ``accuracy="normwise"``.
    boundary : str
        Boundary condition at obstacles: ``"dirichlet"``, ``"neumann"``, ``"wall"`` or ``"blend"``.
    edge : tuple of str
        Rule of the grid's edge per axis: ``"periodic"``, ``"obstacle"`` or ``"open"``.
    is_flowing : bool
        Whether any current is nonzero.

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
        wiring, cells = self.wiring, " x ".join(map(str, self.space.shape))
        drive = f", driven by {wiring.drive}" if wiring.is_driven else f", leak {wiring.leak:g}" if wiring.leak else ""
        return f"<Field on {cells} cells: {self.boundary}{drive}, k = {self.k:g}>"

    _repr_html_ = picture_html

    @property
    def boundary(self) -> str:
        """Boundary condition at obstacles: ``"dirichlet"``, ``"neumann"``, ``"wall"`` or ``"blend"``."""
        return "blend" if 0.0 < self.k < 1.0 else self.wiring.boundary

    @property
    def edge(self) -> tuple[str, ...]:
        """Rule of the grid's edge per axis: ``"periodic"``, ``"obstacle"`` or ``"open"``."""
        return self.wiring.edges(self.space)

    @property
    def is_flowing(self) -> bool:
        """Whether any current is nonzero."""
        return any(direction.any() for direction in self.face_direction)

    def __getstate__(self) -> dict[str, Any]:
        return {attribute.name: getattr(self, attribute.name) for attribute in dataclasses.fields(self)}

    def face_current(self, axis: int) -> NDArray[np.float64]:
        """Return the signed current through every face across an axis, in units of supply / resistance.

        The shape is that of the space plus one along the axis.  Currents beyond the range of float64 underflow to 0.
        """
        return np.asarray(self.face_direction[axis] * np.exp(self.face_log_current[axis]), dtype=np.float64)

    def faces_of(self, cells: NDArray[np.int64]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        """Return signs and ln magnitudes (2, n, ndim) of currents through lower and upper faces of cells (n, ndim)."""
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
        """Return the scaled gradient of the potential at points within cells, and the logarithm of the scale.

        At conductivity c the current through a face of axis ``a`` is ``c (h_ref / h_a)**2`` times the decrease of the
        potential.  So c times the gradient is minus the current times ``h_a / h_ref**2``, and linear between faces.

        Parameters
        ----------
        cells : ndarray of int64, shape (n, ndim)
            The cells of the points.
        local : ndarray of float64, shape (n, ndim)
            Position within each cell, in [0, 1].

        Returns
        -------
        gradient : ndarray of float64, shape (n, ndim)
            Gradient times ``c h_ref**2``, divided by the scale of the point's cell.
        log_scale : ndarray of float64, shape (n,)
            Natural logarithm of the scale, the largest current through a face of the cell; 0 without current.
        """
        direction, log_current = self.faces_of(cells)
        largest = log_current.max(axis=(0, 2))
        base = np.where(np.isfinite(largest), largest, 0.0)
        lower, upper = direction * np.exp(log_current - base[:, np.newaxis])
        return -((1.0 - local) * lower + local * upper) * self.space.spacing, base

    @cached_property
    def obstacle_reach(self) -> NDArray[np.float64] | None:
        """Upper bounds of the distance from any point of each cell to the nearest obstacle cell, in axis units.

        Shape of the space; None without an obstacle cell.
        """
        return obstacle_reach(self.space)

    @cached_property
    def flow(self) -> Flow:
        """Cell codes, cell sizes and currents of the field as flat arrays, the input of compiled tracing kernels."""
        from resgrid.planning.kernels import Flow

        space = self.space
        shapes = [face_shape(space.shape, axis) for axis in range(space.ndim)]
        return Flow(
            code=_stop_codes(space, self.safe),
            shape=np.array(space.shape, dtype=np.int64),
            spacing=space.spacing,
            first_face=np.cumsum([0, *face_counts(space.shape)[:-1]], dtype=np.int64),
            face_stride=np.array([np.cumprod([1, *shape[:0:-1]])[::-1] for shape in shapes], dtype=np.int64),
            direction=_flattened(self.face_direction),
            log_current=_flattened(self.face_log_current),
        )


def _stop_codes(space: ConfigurationSpace, safe: NDArray[np.bool_] | None) -> NDArray[np.uint8]:
    """Return `Cell` codes (cells,), with `GOAL`, where tracing stops, also in free cells outside the mask `safe`."""
    if safe is None:
        return space.cell.ravel()
    return np.where((space.cell == Cell.FREE) & ~safe, np.uint8(Cell.GOAL), space.cell).ravel()


def _flattened(parts: tuple[NDArray[Any], ...]) -> NDArray[Any]:
    """Return the concatenation (n,) of the flattened `parts`; no copy if they are consecutive views of one array."""
    whole = parts[0].base
    if isinstance(whole, np.ndarray) and whole.ndim == 1 and whole.size == sum(part.size for part in parts):
        ends = np.cumsum([0, *(part.nbytes for part in parts)]) + whole.ctypes.data
        if all(part.flags.c_contiguous and part.ctypes.data == at for part, at in zip(parts, ends, strict=False)):
            return whole
    return np.concatenate([part.ravel() for part in parts])


def field(op: OperatingPoint | WarmPoint) -> Field:
    """Return the field of a configuration space, computed from the operating point of its netlist.

    Parameters
    ----------
    op : OperatingPoint or WarmPoint
        Operating point of a netlist compiled from a space, or solution of a warm start.  Cells without a path to a goal
        may have no potential in a warm start.

    Returns
    -------
    Field
        Potential and face currents in all cells.

    Raises
    ------
    InputError
        If the netlist was not compiled from a space, or has neither two rails nor one rail and a drive.
    CircuitError
        If no current flows through any free cell.
    AccuracyError
        If the resistance of the chip's switches or rails lets current flow from free cells into obstacles; the error
        carries the field.

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
    if np.any(cells.resistor_face == -1):
        _check_walls(result)
    safe = safe_cells(op)
    return result if safe is None else replace(result, safe=safe)


Elements = tuple[NDArray[np.integer[Any]], NDArray[np.bool_], NDArray[np.int8], NDArray[np.float64]]
"""Four arrays (elements,): index of the face that the element crosses (-1 for none), whether its first node is on the
lower side, sign of the current out of this node, natural logarithm of the current's magnitude in amperes."""


def read_field(
    cells: CellMap,
    volts: float,
    potential: NDArray[np.float64],
    log_drop: NDArray[np.float64] | None,
    *elements: Elements,
) -> Field:
    """Return the field of a compiled circuit.

    `cells`: map of the nodes; `volts`: signed voltage of a potential difference of 1; `potential`, `log_drop` (nodes,):
    values of the nodes, `log_drop` None without a drop; `elements`: currents of one or more kinds of elements.
    """
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
        face_direction=_wrapped(by_axis(direction, space.shape), space),
        face_log_current=_wrapped(by_axis(log_current, space.shape), space),
        k=0.0 if cells.wiring.is_open else 1.0,
    )


def read_cells(space: ConfigurationSpace, wiring: Wiring, voltage: NDArray[np.float64], *, check: bool = True) -> Field:
    """Return the field for given voltages of the cells of a space.

    `voltage` (shape of the space): in volts, NaN for a cell without a node; a goal-connected cell with NaN gets the
    goal's voltage; `check`: whether `Field.safe` is computed from the KCL residuals; otherwise it is None.
    """
    at_goal = (space.cell == Cell.GOAL) | (space.goal_connected & np.isnan(voltage))
    volts = np.where(at_goal, wiring.goal_voltage, voltage)
    volts[space.cell == Cell.OBSTACLE] = np.nan if wiring.is_open else wiring.high
    if wiring.start is not None:
        volts[wiring.start] = wiring.high
    height = (volts - wiring.goal_voltage) * np.sign(wiring.supply)
    unit = np.nanmax(height) if wiring.drive == "uniform" else abs(wiring.supply)
    contacts, wide = contacts_of_box(space, wiring.on(space)), with_margin(volts, space.periodic)
    wide[contacts.kind == CellRole.HIGH] = wiring.high
    currents = face_currents(contacts.conductance, np.sign(wiring.supply) * wide)
    if not (unit > 0.0 and any(current.any() for current in currents)):
        raise CircuitError(
            "nothing is driven: all cells are at the voltage of the goal; move the goal, or open a passage to it"
        )
    safe = None
    if check:
        driven = np.count_nonzero(space.goal_connected) if wiring.drive == "uniform" else 0
        injected = abs(wiring.supply) / (wiring.resistance * driven) if driven else 0.0
        leaked, uncertain = leak_currents(contacts.leak, wiring, volts)
        safe = (space.cell == Cell.FREE) & between_rails(height, wiring)
        safe &= obeys_kcl(contacts.conductance, wide, currents, injected + leaked, uncertain=uncertain)
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
        k=0.0 if wiring.is_open else 1.0,
        safe=safe,
    )


def _wrapped(faces: tuple[NDArray[Any], ...], space: ConfigurationSpace) -> tuple[NDArray[Any], ...]:
    """Return `faces`, one array per axis, after copying the first face to the last on every periodic axis, in place."""
    for axis in np.flatnonzero(space.periodic).tolist():
        along = np.moveaxis(faces[axis], axis, 0)
        along[-1] = along[0]
    return faces


def undriven_field(space: ConfigurationSpace, wiring: Wiring) -> Field:
    """Return a field without currents: potential 0 in goal-connected cells, 1 in obstacles on a rail, NaN elsewhere."""
    faces = sum(face_counts(space.shape))
    potential = np.where(space.goal_connected | (space.cell == Cell.GOAL), 0.0, np.nan)
    if not wiring.is_open:
        potential[space.cell == Cell.OBSTACLE] = 1.0
    return Field(
        space=space,
        wiring=wiring,
        potential=potential,
        log_drop=None,
        face_direction=by_axis(np.zeros(faces, dtype=np.int8), space.shape),
        face_log_current=by_axis(np.full(faces, -np.inf), space.shape),
        k=0.0 if wiring.is_open else 1.0,
    )


def _check_driven(op: OperatingPoint, cell_map: CellMap) -> None:
    """Raise CircuitError unless current flows through a free cell, and not only between goal and obstacle cells."""
    free = np.zeros(op.netlist.node_count, dtype=np.bool_)
    free[cell_map.free_node] = True
    if not op.resistor_current[free[op.netlist.resistor_nodes].any(axis=1)].any():
        raise CircuitError(
            "nothing is driven: no free cell lies between the goal and an obstacle, so that all free cells are at one "
            "voltage; move the goal, or open a passage to it"
        )


def _check_walls(field: Field) -> None:
    """Raise AccuracyError if, in a non-ideal chip, current flows from a goal-connected cell into an obstacle."""
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
                f"{int(enters.sum())} obstacle contacts of this chip draw current out of free cells (such as {cell}), "
                "so that streamlines would enter obstacles: reduce the resistance of its switches and rails",
                field,
            )


def _per_cell(cell_map: CellMap, value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values of the nodes, `value` (nodes,), in the shape of the space; NaN in cells without a node."""
    return np.where(cell_map.node >= 0, value[cell_map.node], np.nan)
