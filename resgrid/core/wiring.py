"""Boundary conditions, drive and element values for compiling a configuration space into a netlist."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.validation import checked
from resgrid.core.cell import Cell
from resgrid.core.lattice import LatticeName, require_square
from resgrid.core.lattices import check_lattice
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import CircuitError, InputError, suggestion

Boundary = Literal["dirichlet", "neumann", "wall"]
Drive = Literal["uniform", "start"]
WiringDrive = Literal["uniform", "start", "none"]
EdgeRule = Literal["obstacle", "open", "periodic"]
Rails = Literal["merged", "cells"]

_LEAST_SIEMENS = float(np.finfo(np.float64).tiny)
"""Smallest conductance of a leak, in siemens: the smallest normal number of float64; below it InputError is raised."""


class WiringOptions(TypedDict, total=False):
    """Keyword arguments of functions that take a `Wiring` or its fields; type checkers reject misspelt names.

    Keys, all optional: ``boundary``, ``drive``, ``edge``, ``rails``, ``resistance`` and ``wall_resistance`` (ohm),
    ``supply`` and ``goal_voltage`` (V), ``start`` (cell), ``leak`` (1 / axis unit^2) and ``lattice``, with the meanings
    of the fields of `Wiring`.  None, like a missing key, leaves a field at its default or at its value in the wiring.

    Examples
    --------
    >>> options: rg.WiringOptions = {"boundary": "neumann", "edge": "open"}
    >>> rg.Wiring(**options).drive
    'uniform'
    """

    boundary: Boundary | None
    drive: WiringDrive | None
    edge: EdgeRule | Sequence[EdgeRule] | None
    rails: Rails
    resistance: float | None
    supply: float | None
    goal_voltage: float
    wall_resistance: float | None
    start: Sequence[int] | None
    leak: float
    lattice: LatticeName | None


@checked
@dataclass(frozen=True)
class Wiring:
    """Boundary conditions, drive and element values of a circuit for a configuration space.

    Sources: Tarassenko & Blake 1991; Connolly & Grupen 1992, section 2.

    Parameters
    ----------
    boundary : {"dirichlet", "neumann", "wall"}
        Boundary condition at obstacles: connected to the obstacle rail, open, or connected to the rail through
        `wall_resistance` (a Robin condition).
    drive : {"uniform", "start", "none"}, optional
        Source of current with open obstacles: equal currents into all goal-connected free nodes (default), or the start
        cell tied to the high rail.  None for other boundary conditions, and for open obstacles with a leak.
        ``"none"``, for any boundary condition, is the drive of circuits for effective resistances: no current source
        and no driven start, a node for every free cell, goal-connected or not, and no need for a goal.
    edge : {"obstacle", "open"} or a sequence of these
        Boundary condition at the edge of the grid, for all axes or per axis: the edge acts as an obstacle, or is open.
        Periodic axes have no edge; their entry is ignored, and may also be ``"periodic"``.
    rails : {"merged", "cells"}
        Whether each rail is one node, or every obstacle and goal cell has its own node and source.
    resistance : float
        Resistance between neighbours along the axis with the smallest cell width, at conductivity 1, in ohms.
    supply : float
        Voltage of the obstacle rail, or of the driven start, above the goal rail, in volts; not zero, may be negative.
        With a uniform drive the total injected current is ``supply / resistance``.
    goal_voltage : float
        Voltage of the goal rail, in volts.
    wall_resistance : float, optional
        Resistance in series with every obstacle contact for ``boundary="wall"``, in ohms; 0 is Dirichlet.
    start : sequence of int, optional
        Index of the start cell along every axis, for ``drive="start"``.
    leak : float
        Leak of every free node to the obstacle rail, in 1 / (unit of the axes)^2; 0 for no leak.  The drop ``u`` from
        the obstacle rail then solves the screened Poisson equation ``div(c grad u) = leak u``, and falls by a factor of
        e per ``1 / sqrt(leak)`` (at conductivity 1, far from obstacles).  Open obstacles need no drive then, since the
        leak drives the grid.
    lattice : {"square", "square8", "cube26", "hexagonal"}
        Neighbours of a node: face neighbours of cells; also those across corners in the plane (8 neighbours), or across
        edges and corners in space (26); or six neighbours of a triangular lattice in the plane.  Paths of other
        lattices than "square" run from node to node (`resgrid.planning.node_path`).

    Raises
    ------
    InputError
        If an option is unknown, missing or inconsistent with others.

    Examples
    --------
    >>> space = rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))
    >>> wiring = rg.Wiring("neumann", edge="open", resistance=22e3)
    >>> wiring.is_driven, wiring.edges(space)
    (True, ('open', 'open'))
    >>> rg.compile_space(space, wiring)
    <Netlist of 58 nodes: 88 resistors, 1 voltage source, 56 current sources>
    """

    boundary: Boundary = "dirichlet"
    drive: WiringDrive | None = None
    edge: EdgeRule | Sequence[EdgeRule] = "obstacle"
    rails: Rails = "merged"
    resistance: float = 10e3
    supply: float = 1.0
    goal_voltage: float = 0.0
    wall_resistance: float | None = None
    start: Sequence[int] | None = None
    leak: float = 0.0
    lattice: LatticeName = "square"

    def __post_init__(self) -> None:
        self._check_values()
        self._check_drive()
        normal: dict[str, Any] = {
            "drive": "uniform" if self.is_open and not self.leak and self.drive is None else self.drive,
            "edge": self.edge if isinstance(self.edge, str) else tuple(self.edge),
            "start": None if self.start is None else tuple(int(index) for index in self.start),
        }
        normal |= {name: float(getattr(self, name)) for name in ("resistance", "supply", "goal_voltage", "leak")}
        for name, value in normal.items():
            object.__setattr__(self, name, value)

    def _check_drive(self) -> None:
        """Raise InputError unless the fields `drive` and `start` fit the boundary condition."""
        if self.drive == "none":
            if self.start is not None:
                raise InputError(
                    f"drive = 'none' has no driven start, but start = {self.start!r}; leave out start, or choose "
                    "drive = 'start'"
                )
            return
        if self.boundary != "neumann":
            if self.drive is not None or self.start is not None:
                raise InputError(
                    f"drive and start require open obstacles: with boundary = {self.boundary!r} the obstacle rail "
                    "drives the grid; leave out drive and start, or choose boundary = 'neumann'"
                )
            return
        if self.leak and (self.drive is not None or self.start is not None):
            raise InputError(
                f"leak = {self.leak:g} drives a grid with open obstacles from the obstacle rail, and drive = "
                f"{self.drive or 'start'!r} would be a second source; leave out drive and start, or set leak = 0"
            )
        if (self.drive == "start") != (self.start is not None):
            raise InputError(
                f"drive = {self.drive!r} and start = {self.start!r} do not fit: drive = 'start' requires a start cell, "
                "and a start cell requires drive = 'start'"
            )

    def _check_values(self) -> None:
        """Raise InputError unless resistances and voltages are finite, in range, and fit the boundary condition."""
        if self.rails == "cells":
            require_square(self.lattice, "a node for every rail cell (rails = 'cells', the chip)")
        if self.leak:
            require_square(self.lattice, "a leak to the obstacle rail")
        if not (0 < self.resistance < np.inf and 1.0 / float(self.resistance) < np.inf):
            raise InputError(f"resistance = {self.resistance}, but it must be positive and finite, in ohms")
        if not (np.isfinite(self.supply) and self.supply != 0 and np.isfinite(self.goal_voltage)):
            raise InputError(
                f"supply = {self.supply} V and goal_voltage = {self.goal_voltage} V must be finite, and supply not 0"
            )
        if not 0 <= self.leak < np.inf:
            raise InputError(
                f"leak = {self.leak}, but it must be finite and not negative, in 1 / (unit of the axes)^2; 0 is no leak"
            )
        wall = self.wall_resistance
        if self.boundary != "wall":
            if wall is not None:
                raise InputError(
                    f"wall_resistance = {wall} requires boundary = 'wall', not {self.boundary!r}; leave it out, or "
                    "change the boundary"
                )
        elif wall is None or not (np.isfinite(wall) and wall >= 0):
            raise InputError(
                f"boundary = 'wall' needs a finite wall_resistance of at least 0 ohm, got {wall} "
                "(for an infinite one choose boundary = 'neumann')"
            )

    @property
    def is_open(self) -> bool:
        """Whether obstacles are open, so that no current flows between them and the grid."""
        return self.boundary == "neumann"

    @property
    def is_driven(self) -> bool:
        """Whether current sources or a start cell drive the grid, in place of an obstacle rail."""
        return self.is_open and not self.leak and self.drive != "none"

    @property
    def has_islands(self) -> bool:
        """Whether obstacles are open, and free cells that are not connected to a goal have nodes (drive ``"none"``)."""
        return self.is_open and self.drive == "none"

    @property
    def high(self) -> float:
        """Voltage of the high (obstacle) rail, or of the driven start, relative to ground, in volts."""
        return self.goal_voltage + self.supply

    def leak_conductance(self, spacing: NDArray[np.float64]) -> float:
        """Return the conductance of the leak of one free node to the obstacle rail, ``leak * h_ref**2 / R``.

        With the conductances ``(h_ref / h_a)**2 c / R`` between neighbours, Kirchhoff's current law at a free node is
        the finite-volume form of ``div(c grad u) = leak u``.

        Parameters
        ----------
        spacing : ndarray of float64, shape (ndim,)
            Cell widths; ``h_ref`` is the smallest.

        Returns
        -------
        float
            Conductance in siemens, 0 without a leak.

        Raises
        ------
        InputError
            If the conductance of a positive leak underflows or overflows.
        """
        width = float(np.min(spacing))
        siemens = self.leak * width / self.resistance * width
        if self.leak and not _LEAST_SIEMENS <= siemens < np.inf:
            raise InputError(
                f"leak = {self.leak:g} with cells {width:g} wide is a conductance of {siemens:g} S, outside the range "
                f"from {_LEAST_SIEMENS:g} S; choose another leak (1 / leak^0.5 is the screening length), or 0"
            )
        return siemens

    def edges(self, space: ConfigurationSpace) -> tuple[EdgeRule, ...]:
        """Return the edge rule of every axis of a space.

        Parameters
        ----------
        space : ConfigurationSpace
            The space of the circuit.

        Returns
        -------
        tuple of str
            ``"obstacle"``, ``"open"`` or ``"periodic"`` for every axis.

        Raises
        ------
        InputError
            If there is not one rule per axis, or a rule is ``"periodic"`` for an axis that is not periodic.
        """
        rules = (self.edge,) * space.ndim if isinstance(self.edge, str) else tuple(self.edge)
        if len(rules) != space.ndim:
            raise InputError(f"edge has {len(rules)} entries, but the space has {space.ndim} axes; give one per axis")
        for axis, rule in zip(space.axes, rules, strict=True):
            if rule == "periodic" and not axis.periodic:
                raise InputError(f"edge = 'periodic', but axis {axis.name!r} is not; choose 'obstacle' or 'open'")
        return tuple("periodic" if axis.periodic else rule for axis, rule in zip(space.axes, rules, strict=True))

    def on(self, space: ConfigurationSpace) -> Wiring:
        """Return a copy of the wiring with one edge rule per axis of a space.

        Parameters
        ----------
        space : ConfigurationSpace
            The space of the circuit.

        Returns
        -------
        Wiring
            The wiring, with `edge` as a tuple.

        Raises
        ------
        InputError
            If the edge rules or the lattice do not fit the space, or the start is not a free cell.
        CircuitError
            If no path connects the start to a goal.
        """
        check_lattice(self.lattice, space)
        if self.start is not None:
            _check_start(space, tuple(self.start))
        return replace(self, edge=self.edges(space))

    def opened(self) -> Wiring:
        """Return a copy of the wiring with open obstacles, for the Neumann field of a blend.

        The circuit of the copy is driven by its leak if it has one, and uniformly otherwise.

        Returns
        -------
        Wiring
            The wiring without `wall_resistance` and `start`; with a leak, also without a drive.
        """
        drive: Drive | None = None if self.leak else "uniform"
        return replace(self, boundary="neumann", drive=drive, wall_resistance=None, start=None)


_NO_OPTIONS_OF_BOUNDARY: dict[str, Any] = {"drive": None, "start": None, "wall_resistance": None}
"""Values to which fields of a `Wiring` that belong to one boundary condition are reset when this condition changes."""


def wiring_of(wiring: Wiring | None, options: Mapping[str, Any], default: Mapping[str, Any] | None = None) -> Wiring:
    """Return a wiring with some fields replaced.

    `wiring`: wiring to change, None for a new wiring from the fields `default`; `options`: new values of fields by
    name; None keeps the old value; `default`: fields of a new wiring, by name.  If `options` change the boundary
    condition of `wiring`, the fields ``drive`` (unless it is ``"none"``) and ``start`` are reset to None, and
    ``wall_resistance`` to the value in `default`, or None.  A leak in `options` replaces a uniform drive.
    """
    _check_names(options)
    given = {name: value for name, value in options.items() if value is not None}
    if wiring is None:
        return Wiring(**{**(default or {}), **given})
    if given.get("leak") and wiring.drive == "uniform":
        given = {"drive": None, **given}
    if given.get("boundary", wiring.boundary) == wiring.boundary:
        return replace(wiring, **given)
    wall = (default or {}).get("wall_resistance")
    drive = "none" if wiring.drive == "none" else None
    return replace(wiring, **{**_NO_OPTIONS_OF_BOUNDARY, "drive": drive, "wall_resistance": wall, **given})


def _check_names(options: Iterable[str]) -> None:
    """Raise InputError for a name that is not a field of `Wiring`; `options`: names of keyword arguments."""
    known = [field.name for field in fields(Wiring)]
    for name in options:
        if name not in known:
            hint = suggestion(name, known) or f"there are {', '.join(known)}"
            raise InputError(f"there is no option {name!r}: {hint}")


def _check_start(space: ConfigurationSpace, cell: tuple[int, ...]) -> None:
    """Raise InputError unless the start is a free cell, and CircuitError unless it is connected to a goal.

    `cell`: index of the start cell along every axis.
    """
    if len(cell) != space.ndim or not all(0 <= i < n for i, n in zip(cell, space.shape, strict=True)):
        raise InputError(f"the start cell {cell} is not in the grid of {space.shape} cells; choose another one")
    if space.cell[cell] != Cell.FREE:
        kind = "an obstacle cell" if space.cell[cell] == Cell.OBSTACLE else "a goal cell"
        raise InputError(f"the start cell {cell} is {kind}; choose a free cell")
    if not space.goal_connected[cell]:
        raise CircuitError(
            f"nothing is driven: no path of free cells joins the start cell {cell} to a goal; choose another start"
        )
