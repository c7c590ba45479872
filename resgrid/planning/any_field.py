"""Functions that accept the field of any lattice, square or not: paths, blends, and a check for face currents."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.lattice import SQUARE, require_square
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.planning import fields
from resgrid.planning.blend import blend
from resgrid.planning.fields import Field
from resgrid.planning.lattice_blends import blend_lattice_fields
from resgrid.planning.lattice_fields import LatticeField, lattice_field, undriven_lattice_field
from resgrid.planning.node_paths import NodePath, follow_many_nodes, follow_nodes
from resgrid.planning.streamline import Streamline
from resgrid.planning.trace import Traces, follow, follow_many, one_start, start_points

AnyField = Field | LatticeField
"""Field of the lattice "square", or of another lattice."""

FieldPath = Streamline | NodePath
"""Path along the currents of a field: a `Streamline` on the lattice "square", a `NodePath` on other lattices."""


def field_of(op: OperatingPoint) -> AnyField:
    """Return the field of an operating point: a `Field`, or a `LatticeField` for a lattice other than "square"."""
    return fields.field(op) if op.netlist.lattice_map is None else lattice_field(op)


def undriven(space: ConfigurationSpace, wiring: Wiring) -> AnyField:
    """Return the field of a circuit without currents.

    The potential is 0 in goals and in goal-connected cells (or sites), 1 in obstacles on a rail, and NaN elsewhere.
    """
    if wiring.lattice == SQUARE:
        return fields.undriven_field(space, wiring)
    return undriven_lattice_field(space, wiring)


def blended(dirichlet: AnyField, neumann: AnyField, k: float) -> AnyField:
    """Return the blend ``phi = k phi_D + (1 - k) phi_N`` of two fields of one lattice.

    `dirichlet`, `neumann`: fields with obstacles on the rail and with open obstacles; `k`: weight, in [0, 1].
    """
    if isinstance(dirichlet, LatticeField) and isinstance(neumann, LatticeField):
        return blend_lattice_fields(dirichlet, neumann, k)
    return blend(require_faces(dirichlet, "a blend"), require_faces(neumann, "a blend"), k)


def path_of(field: AnyField, start: ArrayLike | None = None, *, cell: Sequence[int] | None = None) -> FieldPath:
    """Return the path of a field from a start: a streamline, or a path from node to node.

    `start` (ndim,): point in world coordinates, or None; `cell`: cell whose centre is the start, if `start` is None.
    """
    point = one_start(field.space, start, cell)
    return follow_nodes(field, point) if isinstance(field, LatticeField) else follow(field, point)


def paths_of(field: AnyField, starts: ArrayLike) -> list[FieldPath]:
    """Return the paths of a field from starts (n, ndim) in world coordinates."""
    points = start_points(field.space, starts)
    if isinstance(field, LatticeField):
        return [follow_nodes(field, point) for point in points]
    return [follow(field, point) for point in points]


def ends_of(field: AnyField, starts: ArrayLike) -> Traces:
    """Return outcomes, goals, lengths, durations and step counts of the paths of a field from starts (n, ndim).

    The starts are in world coordinates.  Durations are NaN for a lattice other than "square".
    """
    points = start_points(field.space, starts)
    return follow_many_nodes(field, points) if isinstance(field, LatticeField) else follow_many(field, points)


def require_faces(field: AnyField, subject: str) -> Field:
    """Return a field with currents through cell faces; raise InputError for the field of another lattice.

    `subject`: function that needs the currents, for the message.
    """
    if isinstance(field, LatticeField):
        require_square(field.lattice.name, subject)
    assert isinstance(field, Field)
    return field
