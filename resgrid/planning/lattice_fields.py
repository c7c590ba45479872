"""Fields of lattices other than "square": potentials of the nodes, and currents between neighbouring nodes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen, picture_html
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.cell import Cell
from resgrid.core.lattice import Lattice
from resgrid.core.lattice_map import LatticeMap
from resgrid.core.lattices import lattice_of
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.errors import CircuitError, InputError
from resgrid.planning.clearance import obstacle_reach

ReadOut = Literal["density", "current"]

SAME_CURRENT = 1e-9
"""Largest difference of the natural logarithms of two currents, or current densities, that count as equal.

Of several steps with the largest current, a path then takes the first one in the order of the lattice.  Rounding errors
of symmetric currents therefore do not change a path.
"""


@frozen
@dataclass(frozen=True, eq=False)
class LatticeField:
    """Potential and step currents on the lattice of a configuration space.

    Attributes
    ----------
    lattice : Lattice
        Sites and steps of the lattice, with their points and cells.
    wiring : Wiring
        Wiring of the solved circuit; for a blend, wiring of the circuit of k = 1.
    potential : ndarray of float64, shape of the lattice
        ``phi`` at every site: 1 in obstacles that are connected to a rail, 0 in goals; NaN at a site without a node,
        such as in an open obstacle.  With a uniform drive, the height above the goal rail, scaled to a maximum of 1.
    log_drop : ndarray of float64, shape of the lattice, or None
        Natural logarithm of the drop ``u = 1 - phi``, accurate even where ``phi`` rounds to 1; -inf at sites without a
        path to a goal, NaN without a node.  None if the circuit has no high rail (uniform drive), and for blends.
    step_direction : tuple of ndarray of int8
        Sign of the current along a step of the lattice from every site: 1 from the site to its neighbour, -1 towards
        the site, 0 without current; one array of the lattice's shape per step.  Currents into obstacles are left out.
    step_log_current : tuple of ndarray of float64
        Natural logarithm of the current's magnitude, in units of supply / resistance and for the potential as scaled;
        -inf without current.  Shapes of `step_direction`.
    k : float
        Weight of the Dirichlet field: 1 for Dirichlet and walls, 0 for Neumann.
    read_out : {"density", "current"}
        Quantity that decides the step from a site: the largest current density ``I / (g |s|)`` of the current I along a
        step s with the weight g, or the largest current.  The two agree where all resistors are equal, as on a
        hexagonal lattice with equal distances of neighbours.  On other lattices, the largest current prefers the larger
        conductances of face neighbours, and almost never follows a diagonal.
    space : ConfigurationSpace
        Configuration space of the lattice.
    boundary : str
        Boundary condition at obstacles: ``"dirichlet"``, ``"neumann"``, ``"wall"`` or ``"blend"``.
    edge : tuple of str
        Rule of the grid's edge per axis: ``"periodic"``, ``"obstacle"`` or ``"open"``.
    is_flowing : bool
        Whether any current is nonzero.
    next_site : ndarray of int64, shape of the lattice
        Flat index of the next site of a path from every site; -1 without outward current, and in goals.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml")
    >>> field = rg.planning.lattice_field(rg.solve(rg.compile_space(rg.build_space(scene), lattice="hexagonal")))
    >>> field
    <LatticeField on 8 x 9 sites: hexagonal, dirichlet, k = 1>
    >>> field.potential[5, :4].round(3)
    array([0.861, 0.643, 0.798, 0.827])
    """

    lattice: Lattice
    wiring: Wiring
    potential: NDArray[np.float64]
    log_drop: NDArray[np.float64] | None
    step_direction: tuple[NDArray[np.int8], ...]
    step_log_current: tuple[NDArray[np.float64], ...]
    k: float
    read_out: ReadOut = "density"

    def __repr__(self) -> str:
        sites = " x ".join(map(str, self.lattice.shape))
        drive = f", driven by {self.wiring.drive}" if self.wiring.is_driven else ""
        return f"<LatticeField on {sites} sites: {self.lattice.name}, {self.boundary}{drive}, k = {self.k:g}>"

    _repr_html_ = picture_html

    @property
    def space(self) -> ConfigurationSpace:
        """The configuration space of the lattice."""
        return self.lattice.space

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
        return any(direction.any() for direction in self.step_direction)

    @cached_property
    def obstacle_reach(self) -> NDArray[np.float64] | None:
        """Upper bounds of the distance from any point of each cell to the nearest obstacle cell, in axis units.

        Shape of the space; None without an obstacle cell.
        """
        return obstacle_reach(self.space)

    def outward(self, step: int, sense: int) -> NDArray[np.float64]:
        """Return the natural logarithm of the outward current of every site in one direction.

        Parameters
        ----------
        step : int
            Index of the step of the lattice.
        sense : int
            1 for the step, -1 for its negative.

        Returns
        -------
        ndarray of float64, shape (sites,)
            Logarithm of the current in units of supply / resistance; -inf without a current, and for a current that
            flows towards the site.
        """
        direction, log_current = self.step_direction[step].ravel(), self.step_log_current[step].ravel()
        outward = np.where(direction == sense, log_current, -np.inf)
        if sense > 0:
            return outward
        back = self.lattice.neighbours(step, -1).ravel()
        return np.where(back >= 0, outward[back], -np.inf)

    def _rating(self, step: int, sense: int) -> NDArray[np.float64]:
        """Return the natural logarithms of the quantity that `read_out` compares, for every site in one direction.

        The quantity is the outward current ``I``, in units of supply / resistance, or its density ``I / (g |s|)``, with
        the length ``|s|`` of the step in units of the smallest cell width.  The result has the shape (sites,); -inf
        without outward current.  `step`: index of the step; `sense`: 1 for the step, -1 for its negative.
        """
        outward = self.outward(step, sense)
        if self.read_out == "current":
            return outward
        weight = self.lattice.site_weights[step]
        if sense < 0:
            weight = weight[self.lattice.neighbours(step, -1).ravel()]
        length = float(np.linalg.norm(self.lattice.steps[step]) / self.space.spacing.min())
        flows = np.isfinite(outward)
        return np.where(flows, outward - np.log(np.where(flows, weight, 1.0) * length), -np.inf)

    @cached_property
    def largest_rating(self) -> NDArray[np.float64]:
        """Natural logarithm of the largest outward rating of every site, (sites,); -inf without outward current.

        The rating of a step is its current, or its current density if the attribute `read_out` is ``"density"``.
        """
        largest = np.full(self.lattice.size, -np.inf)
        for step, sense in self.lattice.directions:
            np.maximum(largest, self._rating(step, sense), out=largest)
        return largest

    @cached_property
    def move(self) -> NDArray[np.int8]:
        """Index in `Lattice.directions` of the direction in which a path leaves every site, (sites,).

        `Lattice.directions` lists step 0, its negative, step 1, its negative, and so on.  The chosen direction has the
        largest current or density (`read_out`); of several that are equal to within `SAME_CURRENT`, it is the first.
        The index is -1 at sites without outward current.
        """
        largest = self.largest_rating
        move = np.full(self.lattice.size, -1, dtype=np.int8)
        flows = np.isfinite(largest)
        for number, (step, sense) in reversed(list(enumerate(self.lattice.directions))):
            move[flows & (self._rating(step, sense) >= largest - SAME_CURRENT)] = number
        return move

    @cached_property
    def next_site(self) -> NDArray[np.int64]:
        """Flat index of the next site of a path from every site, in the lattice's shape; -1 without outward current."""
        there = np.full(self.lattice.size, -1, dtype=np.int64)
        for number, (step, sense) in enumerate(self.lattice.directions):
            own = np.flatnonzero(self.move == number)
            there[own] = self.lattice.neighbours(step, sense).ravel()[own]
        return there.reshape(self.lattice.shape)


def lattice_field(op: OperatingPoint, *, read_out: ReadOut = "density") -> LatticeField:
    """Return the field of a lattice, computed from the operating point of its netlist.

    Parameters
    ----------
    op : OperatingPoint
        Operating point of a netlist that was compiled from a space with another lattice than "square".
    read_out : {"density", "current"}
        Quantity that decides the step of a path from a site: the largest current density, or the largest current.

    Returns
    -------
    LatticeField
        Potential at all sites and currents along all steps; `resgrid.planning.node_path` follows them.

    Raises
    ------
    InputError
        If the netlist has no such lattice, or neither two rails nor one rail and a drive.
    CircuitError
        If no current flows.

    Examples
    --------
    >>> space = rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))
    >>> field = rg.planning.lattice_field(rg.solve(rg.compile_space(space, lattice="square8")))
    >>> rg.planning.node_path(field, (0.5, 6.5))
    <NodePath reached goal 0: 10 points, length 9.828, clearance 0.5>
    """
    found = op.netlist.lattice_map if isinstance(op, OperatingPoint) else None
    if found is None:
        raise InputError(
            "lattice_field needs the operating point of a lattice: compile_space(space, lattice='square8', 'cube26' or "
            "'hexagonal'); rg.field reads the lattice 'square'"
        )
    if op.method == "none" and not op.resistor_current.any():
        raise CircuitError(
            "nothing is driven: all sites are at the voltage of the goal; move the goal, or open a path to it"
        )
    if op.potential is None:
        raise InputError("this circuit has more rails or drives than a field is defined for")
    wiring, lattice = found.wiring, found.lattice
    volts = wiring.supply
    if wiring.drive == "uniform":
        volts = float(op.voltage[np.nanargmax(op.potential)] - wiring.goal_voltage)
    log_unit = np.log(abs(volts) / wiring.resistance)
    sign, log_amps = op.resistor_direction * int(np.sign(volts)), op.resistor_log_current - log_unit
    directions, logs = [], []
    for step in range(len(lattice.steps)):
        own = found.resistor_step == step
        direction, log_current = np.zeros(lattice.size, dtype=np.int8), np.full(lattice.size, -np.inf)
        direction[found.resistor_site[own]] = sign[own]
        log_current[found.resistor_site[own]] = np.where(sign[own] == 0, -np.inf, log_amps[own])
        directions.append(direction.reshape(lattice.shape))
        logs.append(log_current.reshape(lattice.shape))
    return LatticeField(
        lattice=lattice,
        wiring=wiring,
        potential=_per_site(found, op.potential),
        log_drop=None if op.log_drop is None else _per_site(found, op.log_drop),
        step_direction=tuple(directions),
        step_log_current=tuple(logs),
        k=0.0 if wiring.is_open else 1.0,
        read_out=read_out,
    )


def undriven_lattice_field(space: ConfigurationSpace, wiring: Wiring) -> LatticeField:
    """Return a field without currents: potential 0 at goal-connected sites, 1 in obstacles on a rail, NaN elsewhere."""
    lattice = lattice_of(wiring.lattice, space)
    potential = np.where(lattice.at_sites(space.goal_connected | (space.cell == Cell.GOAL)), 0.0, np.nan)
    if not wiring.is_open:
        potential[lattice.at_sites(space.cell) == Cell.OBSTACLE] = 1.0
    count = len(lattice.steps)
    return LatticeField(
        lattice=lattice,
        wiring=wiring.on(space),
        potential=potential,
        log_drop=None,
        step_direction=(np.zeros(lattice.shape, dtype=np.int8),) * count,
        step_log_current=(np.full(lattice.shape, -np.inf),) * count,
        k=0.0 if wiring.is_open else 1.0,
    )


def _per_site(found: LatticeMap, value: NDArray[np.float64]) -> NDArray[Any]:
    """Return `value` (nodes,) at the sites, in the lattice's shape; NaN at sites without a node."""
    return np.where(found.node >= 0, value[found.node], np.nan)
