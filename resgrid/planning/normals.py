"""Surface normals of bitmap and voxel models (Connolly & Grupen 1992, section 3.1).

The model is connected to the low rail and the edge of the grid to the high rail.  Outside the model, the gradient of
the potential then points along the outward normal of the nearby surface.  This gradient is smooth, although the surface
of the bitmap consists of axis-aligned steps.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import Natural, per_axis
from resgrid.circuit.solve import solve
from resgrid.core.axis import Axis
from resgrid.core.cell import Cell
from resgrid.core.compiler import compile_space
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning import fields
from resgrid.planning.fields import Field
from resgrid.planning.trace import cell_indices

_FLAT = 1e-12
"""Norm of the gradient at a point, relative to the largest gradient at the cell's faces, below which the gradient is
rounding error and no normal is defined."""


def surface_normals(
    model: ConfigurationSpace | ArrayLike,
    points: ArrayLike | None = None,
    *,
    cells: ArrayLike | None = None,
    spacing: float | Sequence[float] = 1.0,
    padding: Natural | None = None,
) -> NDArray[np.float64]:
    """Compute outward unit normals of a model from one Dirichlet field.

    Within a cell, every component of the gradient is linear between two faces; at the centre the values are averaged.
    The error of a normal depends on its distance from the stepped surface.  Measured on discs and balls with random
    centres:

    ======================================  ===============  ==================
    cells                                   mean (degrees)   largest (degrees)
    ======================================  ===============  ==================
    next to a disc, radius 5 to 12 cells    4 to 8           22
    next to a disc, radius 20 to 80 cells   4.6 to 6.1       26
    next to a ball, radius 3 to 9 cells     6.4 to 9.4       27
    next to a ball, radius 12 to 20 cells   6.1 to 6.4       31
    2 to 3 cells away from either           0.5 to 1.9       5
    ======================================  ===============  ==================

    A finer model does not reduce the error in the cells that touch it; normals a few cells away are more accurate.
    Farther away the error decreases until the edge of the grid has an influence, so use a large padding.  Between parts
    of the model, or deep in a concavity, the gradient depends on all nearby surfaces.

    Parameters
    ----------
    model : ConfigurationSpace or array_like of bool
        A bitmap (two axes) or voxels (three), True inside the model; or a space whose obstacle cells are the model
        (one to four axes, periodic ones included).  `resgrid.planning.normals.octree_voxels` makes voxels of
        an octree.
    points : array_like of float, shape (..., ndim), optional
        World coordinates of the normals; cell ``i`` of an array covers ``[i, i + 1] * spacing``.
    cells : array_like of int, shape (..., ndim), optional
        Cells at whose centres normals are computed, instead of `points`.  By default all cells.
    spacing : float or sequence of float
        Cell widths of an array, in any unit.
    padding : int, optional
        Number of free cells added on both sides of every axis that is not periodic.  By default 1 plus a fraction of
        the number of cells of the longest axis: half in one or two dimensions, a quarter in three or four.

    Returns
    -------
    ndarray of float64
        Unit vectors in world coordinates, shape of `points` or `cells`, or ``(*model.shape, ndim)`` for all cells.
        NaN inside the model and where the gradient vanishes (enclosed cavities, symmetric gaps).

    Raises
    ------
    InputError
        If the model is empty or not boolean, or a point lies outside the grid, inside the model or in a cavity.
    BudgetError
        If the field would not fit in memory.

    Examples
    --------
    >>> model = np.zeros((9, 9), dtype=bool)
    >>> model[3:6, 3:6] = True
    >>> rg.planning.surface_normals(model, points=[(2.2, 2.2), (6.8, 2.2)]).round(3)
    array([[-0.707, -0.707],
           [ 0.707, -0.707]])
    """
    space = _model_space(model, spacing)
    at, local = _places(space, points, cells)
    if padding is None:
        padding = max(space.shape) // (2 if space.ndim <= 2 else 4) + 1
    field, margin = _field_around(space, padding)
    flat = at.reshape(-1, space.ndim)
    normals = _directions(field, flat + margin, local.reshape(-1, space.ndim))
    if points is not None or cells is not None:
        _check_defined(space, flat, normals)
    return space.frame.turned_to_world(normals.reshape(at.shape))


def octree_voxels(leaves: ArrayLike, shape: Sequence[int]) -> NDArray[np.bool_]:
    """Convert the solid leaves of an octree or quadtree to voxels.

    Parameters
    ----------
    leaves : array_like of int, shape (n, ndim + 1)
        Lower corner and side of every solid leaf, in voxels.
    shape : sequence of int
        Shape of the voxel array.

    Returns
    -------
    ndarray of bool
        True inside a leaf.

    Raises
    ------
    InputError
        If a leaf does not fit into the array.
    """
    table = np.asarray(leaves)
    size = np.array(shape, dtype=np.int64)
    if table.ndim != 2 or table.shape[1] != len(size) + 1 or table.dtype.kind not in "iu":
        raise InputError(
            f"leaves must be whole numbers of shape (n, {len(size) + 1}), a corner and a side each; got {table.dtype} "
            f"of shape {table.shape}"
        )
    voxels = np.zeros(tuple(size.tolist()), dtype=np.bool_)
    for number, (*corner, side) in enumerate(table.tolist()):
        if side < 1 or min(corner) < 0 or np.any(np.array(corner) + side > size):
            raise InputError(f"leaf {number} at {tuple(corner)}, side {side}, does not fit into {tuple(shape)} voxels")
        voxels[tuple(slice(low, low + side) for low in corner)] = True
    return voxels


def _model_space(model: ConfigurationSpace | ArrayLike, spacing: float | Sequence[float]) -> ConfigurationSpace:
    """Return a space with the cells of the model as goal cells, and with all other cells free.

    `model`: mask of the model's cells, or a space whose obstacle cells are the model; `spacing`: cell widths of a mask.
    """
    if isinstance(model, ConfigurationSpace):
        axes, inside, frame = model.axes, model.cell == Cell.OBSTACLE, model.frame
    else:
        inside = np.asarray(model)
        if inside.dtype.kind != "b" or not 1 <= inside.ndim <= 4 or not inside.size:
            raise InputError(
                f"a model is a boolean array of one to four axes, True inside; got {inside.dtype} of shape "
                f"{inside.shape} (compare an image with its threshold first)"
            )
        widths = per_axis("spacing", spacing, inside.ndim, "positive and finite", above=0.0).tolist()
        sizes = zip("xyzw", inside.shape, widths, strict=False)
        axes, frame = tuple(Axis(name, 0.0, count * width, count) for name, count, width in sizes), None
    if not inside.any():
        raise InputError("the model is empty: no cell of it is solid")
    return ConfigurationSpace(axes, np.where(inside, Cell.GOAL, Cell.FREE), frame=frame)


def _places(
    space: ConfigurationSpace, points: ArrayLike | None, cells: ArrayLike | None
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the cells of points and the positions within the cells, in [0, 1], both (..., ndim).

    `points` (..., ndim): world coordinates, or None; `cells` (..., ndim): cells whose centres are the points, or None;
    without both, the points are the centres of all cells.  Raise InputError if both are given.
    """
    if points is not None and cells is not None:
        raise InputError("give points or cells, not both")
    if points is not None:
        return space.split(space.from_world(points))
    at = np.moveaxis(np.indices(space.shape), 0, -1) if cells is None else cell_indices(space, cells)
    return at, np.full(at.shape, 0.5)


def _field_around(space: ConfigurationSpace, padding: int) -> tuple[Field, NDArray[np.int64]]:
    """Pad a space with free cells, and return the field between the model and the edge of the padded grid.

    The second return value is the padding at either end of every axis, in cells, shape (ndim,); it is 0 on periodic
    axes.  `space`: a space whose goal cells are the model.
    """
    margin = np.where(space.periodic, 0, padding)
    axes = [
        Axis(a.name, a.lower - m * a.spacing, a.upper + m * a.spacing, a.cells + 2 * m, a.periodic, a.unit)
        for a, m in zip(space.axes, margin.tolist(), strict=True)
    ]
    if np.all(space.periodic):
        raise InputError("all axes of the model are periodic, so that the grid has no edge; use a non-periodic axis")
    cell = np.pad(space.cell, [(m, m) for m in margin.tolist()], constant_values=Cell.FREE)
    if not np.any(cell == Cell.FREE):
        raise InputError("the model fills the whole grid: add padding")
    return fields.field(solve(compile_space(ConfigurationSpace(axes, cell)))), margin.astype(np.int64)


def _directions(field: Field, cells: NDArray[np.int64], local: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit vectors along the gradient of the potential at n points, shape (n, ndim).

    `cells` (n, ndim): cells of the points; `local` (n, ndim): positions of the points within the cells, in [0, 1].  NaN
    outside free cells and where the gradient vanishes.
    """
    gradient, _ = field.gradient(cells, local)
    gradient[field.space.cell[tuple(cells.T)] != Cell.FREE] = 0.0
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    defined = length > _FLAT * field.space.spacing.min()
    return np.where(defined, gradient / np.where(defined, length, 1.0), np.nan)


def _check_defined(space: ConfigurationSpace, cells: NDArray[np.int64], normals: NDArray[np.float64]) -> None:
    """Raise InputError, with the reason, if one of n normals is NaN.

    `cells` (n, ndim): cell of each normal; `normals` (n, ndim): unit vectors, NaN where no normal is defined.
    """
    undefined = np.isnan(normals).any(axis=1)
    if not undefined.any():
        return
    cell = tuple(cells[int(np.argmax(undefined))].tolist())
    if space.cell[cell] == Cell.GOAL:
        raise InputError(f"cell {cell} lies inside the model: choose free cells around it")
    raise InputError(
        f"no normal is defined at cell {cell}: the gradient vanishes, because the model encloses the cell or because "
        "it lies midway between parts of the model; choose other cells"
    )
