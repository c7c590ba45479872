"""Lay the nodal equations of a grid out by colour, for the passes of `checkerboard_kernels`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.nodal.multigrid.checkerboard_kernels import Board
from resgrid.nodal.multigrid.checkerboard_setup import (
    fill_faces,
    invert_degrees,
    place_cells,
    spread_unknowns,
    sum_faces,
)

_LEAST_WIDTH = 4
_BLOCK = 1024
"""Places a pass takes at a time: what it touches stays in the first cache."""

_PADDING = 16


def lay_out(
    coupling: sparse.csr_array,
    excess: NDArray[np.float64],
    cell: NDArray[np.int64],
    shape: tuple[int, ...],
    aggregate: NDArray[np.int32],
    unit: float,
) -> tuple[Board, NDArray[np.int64]] | None:
    """Colour the grid and bring the conductances of its faces in order.

    Parameters
    ----------
    coupling : scipy.sparse.csr_array, shape (n, n)
        Conductances between unknowns, in siemens.
    excess : ndarray of float64, shape (n,)
        Conductance from every unknown to the rails, in siemens.
    cell : ndarray of int64, shape (n,)
        Flat index (C order) of every unknown's cell.
    shape : tuple of int
        Of the grid.
    aggregate : ndarray of int32, shape (n,)
        Node of the first coarse level that every unknown belongs to.
    unit : float
        Conductance that counts as 1, in siemens.

    Returns
    -------
    board : Board
    place : ndarray of int64, shape (n,)
        Place of every unknown: its black place, or -1 less its red place.
    None
        Where the grid has no two colours (a ring of an odd number of cells), or rows too short to be worth it.
    """
    width = (shape[-1] + 1) // 2 + 1  # one place is left empty between rows
    if len(shape) < 2 or width < _LEAST_WIDTH:
        return None
    strides = [width * int(np.prod(shape[a + 1 : -1])) for a in range(len(shape) - 1)]
    distance = np.array([*(d for stride in strides for d in (-stride, stride)), 0], dtype=np.int64)
    margin = max(strides) + _PADDING
    colour = (np.indices(shape[:-1]).sum(axis=0).ravel() % 2).astype(np.uint8)
    aside = np.where(colour == 0, -1, 1).astype(np.int64)
    place = place_cells(cell, shape[-1], colour, margin, width)
    places = 2 * margin + width * len(aside)
    faces = np.zeros((2 * len(shape), places), dtype=np.float32)
    wraps = np.empty(2 * sum(int(np.prod(shape)) // size for size in shape), dtype=np.int64)
    rows = (coupling.indptr, coupling.indices, coupling.data)
    count = fill_faces(*rows, place, distance, aside, width, margin, unit, faces, wraps)
    if count < 0:
        return None
    wrap_red, wrap_black, wrap_conductance = _wraps(coupling, place, wraps[:count], unit)
    degrees = np.zeros((2, places))
    black_aggregate = np.full(places, -1, dtype=np.int32)
    spread_unknowns(place, excess, aggregate, unit, degrees[0], degrees[1], black_aggregate)
    board = Board(
        faces=faces,
        distance=distance,
        aside=aside,
        width=width,
        margin=margin,
        block=max(1, _BLOCK // width),
        wrap_red=wrap_red,
        wrap_black=wrap_black,
        wrap_conductance=wrap_conductance,
        wrap_order=np.argsort(wrap_black, kind="stable"),
        red_inverse=degrees[0],
        black_degree=degrees[1],
        black_inverse=np.zeros(places, dtype=np.float32),
        aggregate=black_aggregate,
    )
    sum_faces(board, degrees[0], degrees[1])
    invert_degrees(degrees[0], degrees[1], board.black_inverse)
    return board, place


def _wraps(
    coupling: sparse.csr_array, place: NDArray[np.int64], entries: NDArray[np.int64], unit: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
    """Red and black places, and conductances, of the resistors that close rings, by red places."""
    row = np.searchsorted(coupling.indptr, entries, side="right") - 1
    red, black = -1 - place[row], place[coupling.indices[entries]]
    order = np.argsort(red, kind="stable")
    return red[order], black[order], (coupling.data[entries][order] / unit).astype(np.float32)
