"""Construction and check of a lattice by its name: nine-point or 27-point stencil of cells, or triangular lattice.

A lattice has sites, steps from a site to its neighbours, and a weight for every step.  The weights ``g`` approximate
the Laplacian, ``sum_j g_j (f(x + s_j) - f(x)) = h_ref**2 lap f``.  Here ``s_j`` are the steps, and ``h_ref`` is the
smallest cell width.  Resistors between neighbours have the conductances ``g_j / R`` (Hernandez-Mejia et al. 2018
compare such lattices for path planning).

``square8`` (two axes) and ``cube26`` (three axes) have one site per cell, at its centre.  With ``a_x = 1 / h_x**2`` and
so on, the stencils are sums of products of second differences ``d_x``, ``d_y`` and ``d_z`` (Collatz 1960; Spotz & Carey
1996):

    a_x d_x + a_y d_y + (a_x + a_y) / 12 d_x d_y                                          square8
    sum of a_x d_x + sum of (a_x + a_y) / 12 d_x d_y + (a_x + a_y + a_z) / 90 d_x d_y d_z cube26

Their leading error is a multiple of the Laplacian of the Laplacian.  For harmonic functions the error is therefore of
order 4, and of order 6 on square or cubic cells.  There the weights of steps along one and two axes are 2/3 and 1/6 for
``square8``; those of steps along one, two and three axes are 7/15, 1/10 and 1/30 for ``cube26``.  All weights are
positive if the cell widths are similar: on planes if their ratio is below ``sqrt(5)``.

``hexagonal`` (two axes) has six neighbours per site at one distance, the pitch, and the weight 2/3 for a pitch of
``h_ref``.  Rows of sites are parallel to the first axis.  The pitch divides the cell width along the first axis, and
the distance of rows is at most the cell width along the second axis.  Every cell therefore contains a site, the sites
of a cell are connected within it, and face neighbours are connected: sites are connected exactly if their cells are.
On a periodic second axis the number of rows is even, and the rows are stretched to close the ring; then the weights of
steps along and across the rows differ.
"""

from __future__ import annotations

from resgrid.core.cell_lattices import cell_lattice, stencil_of
from resgrid.core.hexagonal_lattice import hexagonal_lattice, hexagonal_rows
from resgrid.core.lattice import SQUARE, Lattice, LatticeName
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError

_AXES = {"square8": 2, "cube26": 3, "hexagonal": 2}
"""Number of axes that a space must have for a lattice, by name of the lattice."""


def lattice_of(name: LatticeName, space: ConfigurationSpace) -> Lattice:
    """Return the lattice called `name` over a space.

    Raise InputError if the lattice does not fit the axes of the space, and for the name "square", which has no sites.
    """
    check_lattice(name, space)
    if name == SQUARE:
        raise InputError("lattice = 'square' has faces, not sites; compile_space(space) compiles it")
    return hexagonal_lattice(space) if name == "hexagonal" else cell_lattice(name, space)


def check_lattice(name: LatticeName, space: ConfigurationSpace) -> None:
    """Raise InputError unless a lattice fits the number of axes and the cell widths of a space."""
    if name == SQUARE:
        return
    if space.ndim != _AXES[name]:
        fitting = [other for other, axes in _AXES.items() if axes == space.ndim]
        raise InputError(
            f"lattice = {name!r} needs {_AXES[name]} axes, but the space has {space.ndim}; choose "
            f"{' or '.join(map(repr, [SQUARE, *fitting]))}"
        )
    if name == "hexagonal":
        hexagonal_rows(space)
    else:
        stencil_of(name, space)
