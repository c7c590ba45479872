"""Detection of zero pivots: whether ngspice finds the matrix of a circuit with floating nodes singular.

A floating component (nodes without a path to ground) has a singular diagonal block in the conductance matrix.  The
Gaussian elimination of ngspice (Sparse 1.3, double precision) multiplies by the reciprocal of the pivot, so that
rounding may leave a small last pivot instead of zero.  The block is then solved as if it were regular: the voltages in
the component are arbitrary, all others right.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from resgrid.spice.circuit import Circuit

_MOST = 50
"""Largest number of floating components of a circuit for which pivots are computed.

With more of them, all of at least two nodes, it is unknown whether the matrix is singular.
"""

Singular = Literal["yes", "no", "unknown"]


def singularity(circuit: Circuit) -> Singular:
    r"""Return whether Gaussian elimination in ngspice meets a zero pivot, because the circuit has floating nodes.

    "yes": a pivot is zero, and ngspice takes the matrix as singular; "no": rounding errors replace all zero pivots by
    small numbers, or no node floats; "unknown": the pivots are not computed here, or they depend on the order of
    summation in ngspice, which is not known.

    Examples
    --------
    >>> import io
    >>> deck = "* t\nV1 in 0 1\nR1 in 0 1k\nR2 a b {}\n"
    >>> [singularity(Circuit.of(rg.read_spice(io.StringIO(deck.format(ohms))))) for ohms in ("1k", "93")]
    ['yes', 'no']
    """
    if not circuit.is_floating.any():
        return "no"
    parts, sizes = np.unique(circuit.part[circuit.is_floating], return_counts=True)
    if sizes.min() == 1:
        return "yes"
    if len(parts) > _MOST:
        return "unknown"
    found = {_part_singularity(circuit, np.flatnonzero(circuit.part == part)) for part in parts.tolist()}
    return "yes" if "yes" in found else "unknown" if "unknown" in found else "no"


def _part_singularity(circuit: Circuit, nodes: NDArray[np.int64]) -> Singular:
    """Return whether ngspice meets a zero pivot in the elimination of a floating component: "yes", "no" or "unknown".

    "unknown" means that the pivot depends on ngspice's order of summation, that the component has a nonlinear resistor,
    or that it has resistors and also a voltage source or more than two nodes.  `nodes` (n,): numbers of the nodes of
    the component.
    """
    inside = {kind: np.isin(ends, nodes).all(axis=1) for kind, ends in circuit.ends.items()}
    if inside["nonlinear resistor"].any():
        return "unknown"
    if not inside["resistor"].any():  # nodes joined by sources alone: the entries are ones, without rounding
        return "yes"
    if len(nodes) > 2 or inside["voltage source"].any():
        return "unknown"
    ohms = circuit.resistance[inside["resistor"]]
    with np.errstate(divide="ignore", invalid="ignore"):
        conductances = 1.0 / ohms
    # The simulator's order of summation is not known, so both orders must give the same result.
    totals = {float(sum(order)) for order in (conductances.tolist(), conductances[::-1].tolist())}
    pivots = {total - total * (1.0 / total) * total if total else 0.0 for total in totals}
    if not np.isfinite(list(pivots)).all():
        return "unknown"
    return "yes" if pivots == {0.0} else "unknown" if 0.0 in pivots else "no"
