"""Compiled loops that put a grid's conductances in proportion to a height."""

from __future__ import annotations

from numba import njit

from resgrid.solvers.multigrid.board_passes import Board, Floats, Integers, Reals, add_into_black, relax_red


@njit(cache=True)
def transform(board: Board, height: Floats, faces: Floats, leak: Floats) -> None:
    """Fill ``faces`` with ``g_ij h_i h_j``, and ``leak``, shape (2, places), with ``h_i (A h)_i``; links left out.

    ``leak`` comes as what links draw, ``sum_j g_ij h_j``.
    """
    margin, places = board.margin, board.faces.shape[1]
    red, black = height
    for k in range(margin, places - margin):
        drawn = 0.0
        for q in range(len(board.distance)):
            g, there = board.faces[q, k], k + board.distance[q]
            faces[q, k] = g * red[k] * black[there]
            drawn += g * black[there]
            leak[1, there] += g * red[k]
        leak[0, k] += drawn
    for k in range(places):
        degree = 1.0 / board.red_inverse[k] if board.red_inverse[k] > 0.0 else 0.0
        leak[0, k] = red[k] * (degree * red[k] - leak[0, k])
        leak[1, k] = black[k] * (board.black_degree[k] * black[k] - leak[1, k])


@njit(cache=True)
def scale_faces(faces: Floats, distance: Integers, margin: int, scale: Floats, scaled: Reals) -> None:
    """``scaled = t_i g_ij t_j`` over all faces."""
    for q in range(len(distance)):
        away = distance[q]
        for k in range(margin, faces.shape[1] - margin):
            scaled[q, k] = faces[q, k] * scale[0, k] * scale[1, k + away]


@njit(cache=True)
def smooth(board: Board, currents: Floats, x: Floats, sweeps: int) -> None:
    """Gauss-Seidel by colour, in place: positive numbers stay positive; ``currents`` and ``x`` of shape (2, places)."""
    for _ in range(sweeps):
        relax_red(board, currents[0], x[1], x[0])
        add_into_black(board, x[0], currents[1], x[1])
        for k in range(x.shape[1]):
            x[1, k] = x[1, k] / board.black_degree[k] if board.black_degree[k] > 0.0 else 0.0
