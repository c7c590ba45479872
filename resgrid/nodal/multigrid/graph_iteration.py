"""Flexible conjugate gradients over the rows of a netlist that is no grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.multigrid import kernels
from resgrid.nodal.multigrid.kernels import Stack
from resgrid.nodal.multigrid.stack import own_work
from resgrid.nodal.multigrid.stopping import DRIFT, LEAST_GAIN, MOST_ITERATIONS, ErrorBound
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.watch import Watch


def iterate_on_graph(
    system: NodalSystem,
    stack: Stack,
    b: NDArray[np.float64],
    rtol: float,
    guess: NDArray[np.float64] | None,
    watch: Watch,
) -> tuple[NDArray[np.float64], float]:
    """As `resgrid.nodal.multigrid.iteration.iterate`, over the rows of a netlist."""
    matrix, stack = matrix_rows(system), own_work(stack)
    n = len(b)
    x, r, z = np.zeros(n), b.copy(), np.empty(n, dtype=np.float32)
    goal, left, error = rtol * kernels.norm(b), MOST_ITERATIONS, ErrorBound(guess, rtol)
    if guess is not None:
        x = guess.copy()
        kernels.subtract_product(*matrix, b, x, r)
    size = kernels.norm(r)
    watch.begin(size, goal)
    while size > goal and left > 0 and not error.small:
        p, s, w = np.zeros(n), np.zeros(n), np.empty(n)
        trial, recursive, energy = x.copy(), size, 0.0
        while recursive > 0.7 * goal and left > 0 and not error.small:
            kernels.apply(stack, r, recursive, z)
            zr, zw, zs = kernels.multiply(*matrix, z, r, s, w)
            beta = -zs / energy if energy > 0.0 else 0.0
            energy = zw + beta * zs
            if not energy > 0.0:
                break
            recursive = float(np.sqrt(kernels.advance(z, w, p, s, trial, r, beta, zr / energy)))
            error.moved(p, zr / energy, zr * zr / energy)
            watch.step(recursive)
            left -= 1
        true = kernels.subtract_product(*matrix, b, trial, r)
        if not true < LEAST_GAIN * size:
            break
        error.small &= true <= max(DRIFT * recursive, goal)
        x, size = trial, true
    return x, size


def matrix_rows(
    system: NodalSystem,
) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.float64], NDArray[np.float64]]:
    """The nodal matrix in compressed rows, with indices that need no sign."""
    coupling = system.coupling
    return coupling.indptr.view(np.uint32), coupling.indices.view(np.uint32), coupling.data, system.excess
