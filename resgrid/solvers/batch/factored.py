"""Many chips of any circuit: conjugate gradients, preconditioned by the factors of the nominal one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.solvers.batch.chips import Chip
from resgrid.solvers.laplacian import Laplacian

_MOST_ITERATIONS = 200

_ROUNDING = 1e-9
"""Error, as the nominal chip tells it, that is let pass where rounding forbids a smaller one."""


@dataclass(frozen=True, eq=False)
class FactoredBatch:
    """A circuit made ready for other conductances.

    `start` (n,): where the iteration begins, in volts.
    """

    laplacian: Laplacian
    start: NDArray[np.float64]
    name = "direct"

    def solve(
        self, chips: Iterable[Chip], rtol: float, solution: NDArray[np.float64], reached: NDArray[np.bool_]
    ) -> None:
        """As `resgrid.solvers.batch.boards.BoardBatch.solve`.

        ``rtol`` bounds the error, as the residual and the nominal chip tell it, relative to the largest voltage.
        """
        edges, nominal = self.laplacian.edges, power_of_two(self.laplacian.diagonal)
        for number, (x, chip) in enumerate(zip(solution, chips, strict=True)):
            unit = nominal * chip.mostly
            other = sparse.csr_array((chip.entries / unit, edges.indices, edges.indptr), shape=edges.shape)
            diagonal = other.sum(axis=1) + chip.ground / unit
            x[:] = self.start
            least = chip.least / chip.mostly
            reached[number] = _iterate(other, diagonal, chip.drive / unit, self._factors, least, rtol, x)

    @cached_property
    def _factors(self) -> Any:
        return _factors(self.laplacian)

    def __getstate__(self) -> dict[str, Any]:
        """Without factors, which no process can hand to another."""
        return {"laplacian": self.laplacian, "start": self.start}


def factored_batch(laplacian: Laplacian, drive: NDArray[np.float64]) -> FactoredBatch:
    """Factor the nominal circuit.  Shapes: `drive` (n,)."""
    start = np.asarray(_factors(laplacian).solve(drive / power_of_two(laplacian.diagonal)))
    return FactoredBatch(laplacian, start)


def power_of_two(degree: NDArray[np.float64]) -> float:
    """The power of two at or below the largest conductance, in siemens: all others are told in it, without rounding."""
    return float(2.0 ** np.floor(np.log2(degree.max())))


def _factors(laplacian: Laplacian) -> Any:
    from resgrid.solvers.superlu import symmetric_factors

    return symmetric_factors(laplacian.matrix / power_of_two(laplacian.diagonal))


def _iterate(
    coupling: sparse.csr_array,
    degree: NDArray[np.float64],
    b: NDArray[np.float64],
    factors: Any,
    least: float,
    rtol: float,
    x: NDArray[np.float64],
) -> bool:
    """Conjugate gradients in place, begun anew from the true residual; returns whether the error is small.

    No residual, however small beside what stiff parts carry, hides what it does to weak ones: if all conductances are
    at least ``least`` times the nominal ones, then ``A >= least * A0``, and ``A^-1 r`` is at most ``A0^-1 r / least``
    (in energy; of single voltages it is an estimate).
    """
    rtol *= least
    left, last = _MOST_ITERATIONS, np.inf
    while True:
        r = b - (degree * x - coupling @ x)
        z = factors.solve(r)
        error, size = float(np.abs(z).max()), float(np.abs(x).max())
        if error <= rtol * size:
            return True
        if not (error < 0.5 * last and left > 0):
            return error <= max(rtol, _ROUNDING * least) * size
        last = error
        p, rz = np.zeros_like(r), np.inf
        while left > 0 and np.abs(z).max() > 0.5 * rtol * size:
            before, rz = rz, float(r @ z)
            p = z + (rz / before) * p
            q = degree * p - coupling @ p
            energy = float(p @ q)
            if not energy > 0.0:
                break
            x += rz / energy * p
            r -= rz / energy * q
            z = factors.solve(r)
            left -= 1
