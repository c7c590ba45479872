"""Assembly of nodal matrices and currents for elements whose conductances change at every time step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from resgrid.errors import AccuracyError

Vector = NDArray[np.float64]
Solve = Callable[[Vector], Vector]


@dataclass(frozen=True, eq=False)
class Stamps:
    """Positions of elements in the rows of nodal equations, and in the sparse nodal matrix (n, n).

    `size`: number of rows n; `first`, `second` (elements,): rows of both nodes, n for a node without a row; `element`,
    `sign`, `position` (entries,): element of every stamp, 1 on the diagonal or -1, index in the matrix data; `indices`,
    `pointers`: pattern of the matrix in compressed columns.
    """

    size: int
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    element: NDArray[np.int64]
    sign: Vector
    position: NDArray[np.int64]
    indices: NDArray[np.int32]
    pointers: NDArray[np.int32]

    @classmethod
    def of(cls, rows: NDArray[np.int32], size: int) -> Stamps:
        """Return the positions of elements in the nodal matrix.

        `rows` (elements, 2): rows of both nodes, -1 for a node without a row; `size`: number of rows n.
        """
        ends = np.where(rows < 0, size, rows).astype(np.int64)
        first, second = ends.T
        own, other = np.concatenate([first, second, first, second]), np.concatenate([first, second, second, first])
        sign, element = np.repeat([1.0, 1.0, -1.0, -1.0], len(ends)), np.tile(np.arange(len(ends)), 4)
        inside = (own < size) & (other < size)
        keys, position = np.unique(other[inside] * size + own[inside], return_inverse=True)
        counts = np.bincount(keys // max(size, 1), minlength=size)
        return cls(
            size=size,
            first=first,
            second=second,
            element=element[inside],
            sign=sign[inside],
            position=position.ravel().astype(np.int64),
            indices=(keys % max(size, 1)).astype(np.int32),
            pointers=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        )

    def across(self, volts: Vector) -> Vector:
        """Return the differences of row values across the elements, first node minus second, (elements,).

        A node without a row has the value 0.  `volts` (n,): values of the rows.
        """
        padded = np.append(volts, 0.0)
        return np.asarray(padded[self.first] - padded[self.second])

    def out_of(self, amps: Vector) -> Vector:
        """Return the sum of the element currents that leave every row, in the unit of `amps`, (n,).

        `amps` (elements,): currents from the first to the second node.
        """
        count = self.size + 1
        out = np.bincount(self.first, amps, count) - np.bincount(self.second, amps, count)
        return np.asarray(out[: self.size])

    def factorized(self, weights: Vector) -> Solve:
        """Return a function that solves with the nodal matrix of the elements; raise AccuracyError if it is singular.

        The function maps a right-hand side (n,), in amperes, to the row voltages (n,), in volts.  `weights`
        (elements,): conductances in siemens.
        """
        if not self.size:
            return lambda right: right
        data = np.bincount(self.position, self.sign * weights[self.element], len(self.indices))
        matrix = sparse.csc_matrix((data, self.indices, self.pointers), shape=(self.size, self.size))
        try:
            return splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve
        except RuntimeError as error:
            raise AccuracyError(
                "the equations of the circuit are singular in double precision; check that off_resistance is not many "
                "orders of magnitude above on_resistance"
            ) from error
