"""Time constants ``tau`` and modes ``v`` of RC circuits, from ``C v = tau G v``, and linear solvers for them.

Results are also accurate if the connections to the rails are weak.  ``G`` is the conductance matrix, ``C`` the
capacitance matrix.

A Laplacian is ``F^T F``, where ``F`` has a row for every element: the root of its conductance (or capacitance) times
the difference of its two voltages.  Differences are formed first, so that a weak connection of a stiff island to a rail
is not rounded away in a summed diagonal.

Of circuits with at most `DENSE` unknown voltages all modes are computed, each to a small relative error of its time
constant, however far apart the time constants are.  With ``G = L D L^T`` and ``C = F^T F``, the time constants are the
squares of the singular values of ``F L^-T D^-1/2``.  Star-mesh elimination subtracts nothing (Grassmann, Taksar &
Heyman 1985).  Jacobi's method is accurate for matrices that are ill-conditioned only through scaling (Drmac & Veselic
2008).

In larger circuits the slowest time constants come from Lanczos iteration on ``F G^-1 F^T`` (ARPACK; Lehoucq, Sorensen &
Yang 1998).  The iteration is repeated with the computed modes projected out until no slower one appears, because an
iteration from one vector finds a single copy of a multiple eigenvalue (Parlett 1998, section 12.4), and symmetric grids
have many.  The fastest time constant comes from Lanczos iteration on ``B C^-1 B^T`` with ``G = B^T B``, which needs no
solve with ``G``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.circuit.dynamics import Dynamics, factor_resolvent
from resgrid.errors import AccuracyError, InputError
from resgrid.solvers.factors import Factor
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.scaled import BITS
from resgrid.solvers.selected_inverse import symmetric_factors

Floats = NDArray[np.float64]
LinearMap = Callable[[Floats], Floats]
"""Function from a vector (n,) to the product of a fixed matrix, or of its inverse, with the vector."""

_SOLVE_RTOL = 1e-11
"""Largest accepted normwise relative backward error of linear solutions by the normwise solver."""
_SPOILT = 1e-9
"""Largest accepted difference between the normwise and the componentwise solution for the Elmore delays, as a fraction
of the largest delay.  Beyond it, the componentwise solver is used.
"""

_PROVED = 1e-3
"""Largest accepted bound on the relative error of Elmore delays; the bound is pessimistic.  Beyond it, AccuracyError is
raised.
"""

_ENTRYWISE = 1e-10
"""Largest accepted componentwise backward error of a linear solution; beyond it, AccuracyError is raised."""


def laplacian_root(laplacian: Laplacian) -> sparse.csr_array:
    """Return the root ``F`` of a Laplacian ``F^T F``, shape (m, n), with one row for each of the m elements.

    An element is a conductance or a capacitance between two rows, or from a row to a known voltage.
    """
    incidence, value = laplacian.elements
    return sparse.csr_array(sparse.diags_array(np.sqrt(value)) @ incidence)


def accurate_solver(factors: Factor, capacitance: Laplacian) -> LinearMap:
    """Return a function from a right-hand side (n,) to a solution (n,) that is accurate enough for time constants.

    Two solvers compute the delays ``A^-1 q``, an upper bound of the Elmore delays: ``q`` is the total capacitance at
    each row, or the smallest of these at a row without capacitance.  The function is the normwise solver if its delays
    differ from those of the componentwise solver by at most 1e-9 (`_SPOILT`) of the largest delay; else it is the
    componentwise solver. The largest delays belong to the slowest parts of the circuit, where rounding errors appear
    first.

    `factors`: factors of the matrix ``A``, which is ``G`` or ``G + s C``; `capacitance`: ``C``.  Raises AccuracyError
    if the bound on the relative error of the componentwise delays exceeds 1e-3 (`_PROVED`).
    """

    def plain(b: Floats) -> Floats:
        return factors.solve(np.ravel(b), rtol=_SOLVE_RTOL)

    charge, watch = capacitance.diagonal, ProgressMonitor()
    charge = np.where(charge > 0.0, charge, charge[charge > 0.0].min(initial=np.inf))
    delay = entrywise_solution(factors, charge, watch)
    if not watch.bound <= _PROVED:
        raise AccuracyError(
            "the conductances span too many orders of magnitude to time weakly tied parts; join the nodes that "
            "very large ones connect, or leave very small ones out"
        )
    try:
        spoilt = np.abs(plain(charge) - delay).max(initial=0.0) > _SPOILT * delay.max(initial=0.0)
    except AccuracyError:
        spoilt = True
    return partial(entrywise_solution, factors) if spoilt else plain


def entrywise_solution(factors: Factor, b: Floats, watch: ProgressMonitor | None = None) -> Floats:
    """Return the solution (n,) of a linear system, from separate solves for the positive and negative part of `b`.

    The solution of each part is accurate componentwise; the difference of the two solutions need not be.  `factors`:
    factors of the matrix; `b` (n,): right-hand side (currents), in amperes; `watch`: monitor that records the error
    bound of each solve, None for no record.  Raises AccuracyError for an inaccurate or infinite solution.
    """
    x, low = np.zeros(len(b)), np.zeros(len(b))
    for sign in (1.0, -1.0):
        currents = np.maximum(sign * b, 0.0)
        if not currents.any():
            continue
        part, error = factors.solve_nonnegative(currents, watch=watch)
        if not error <= _ENTRYWISE:
            raise AccuracyError(
                f"voltages have a componentwise backward error of {error:.1e}: conductances span too many orders of "
                "magnitude, or are extreme; join the nodes that very large ones connect"
            )
        power = BITS * part.exponent
        x += sign * np.ldexp(part.hi, power)
        low += sign * np.ldexp(part.lo, power)
    x += low
    if not np.isfinite(x).all():
        raise AccuracyError("voltages overflow; give smaller sources")
    return x


@dataclass(frozen=True, eq=False)
class Modes:
    """Modes of a circuit: the slowest ones or, with `whole`, all of them.

    `tau` (k,): time constants, slowest first, in seconds; `shape` (n, k): voltages of the rows (unknown voltages) in
    every mode, normalised so that ``shape.T @ C @ shape`` is the identity, with ``C`` in farads; `whole`: whether these
    are all modes of the circuit.
    """

    tau: Floats
    shape: Floats
    whole: bool


def all_modes(dynamics: Dynamics) -> Modes:
    """Compute all modes of a circuit by dense linear algebra, in a time proportional to the cube of the number of rows.

    Returns them as Modes.  `dynamics`: equations of a circuit with at most a few hundred rows (unknown voltages).
    """
    from scipy.linalg import solve_triangular
    from scipy.linalg.lapack import dgejsv

    live, size = require_charge(dynamics), dynamics.size
    L, pivot = _star_mesh(dynamics.conductance)
    basis = solve_triangular(L.T, np.eye(size), unit_diagonal=True) / np.sqrt(pivot)
    X = laplacian_root(dynamics.capacitance) @ basis
    X = np.pad(X, ((0, max(0, size - len(X))), (0, 0)))
    unit = 2.0 ** np.floor(np.log2(np.abs(X).max()))
    value, _, V, work, _, info = dgejsv(X / unit, joba=2, jobu=3, jobv=0, jobr=0, jobp=0)
    with np.errstate(all="ignore"):
        root = value[:live] * (work[0] / work[1] * unit)
        tau = root**2
    if info or not (np.isfinite(tau).all() and (tau > 0).all()):
        raise AccuracyError("the time constants span too many orders of magnitude; leave the smallest elements out")
    return Modes(tau, basis @ (V[:, :live] / root), whole=True)


def _star_mesh(laplacian: Laplacian) -> tuple[Floats, Floats]:
    """Return ``L``, shape (n, n), and the diagonal of ``D``, shape (n,), of the factors ``L D L^T`` of a Laplacian.

    Star-mesh elimination computes both without subtractions.  ``L`` is lower triangular with unit diagonal, ``D``
    diagonal.
    """
    edges, ground = laplacian.edges.toarray(), laplacian.ground.copy()
    L, pivot = np.eye(len(ground)), np.empty(len(ground))
    for k in range(len(ground)):
        mesh, rest = edges[k, k + 1 :], edges[k + 1 :, k + 1 :]
        pivot[k] = ground[k] + mesh.sum()
        share = mesh / pivot[k]
        L[k + 1 :, k] = -share
        ground[k + 1 :] += share * ground[k]
        rest += np.outer(share, mesh)
        np.fill_diagonal(rest, 0.0)
    return L, pivot


DENSE = 200
"""Largest number of rows (unknown node voltages) for which all modes of a circuit are computed by dense linear algebra.
"""

_RTOL = 1e-12
"""Relative residual of an eigenpair at which the iteration for slow modes stops, close to the rounding error."""
_PROBE_RTOL = 1e-3
"""Relative residual of an eigenpair at which the search for further slow modes stops."""
_FASTEST_RTOL = 5e-3
"""Relative residual of the eigenpair at which the iteration for the fastest mode stops; the relative error of its time
constant is of the order of the squared residual.
"""

_RESOLVED = 1e-12
"""Smallest time constant that the iteration determines in spite of rounding errors, as a fraction of the slowest;
faster ones are left out.
"""

_KRYLOV, _PROBE_KRYLOV = 20, 10
"""Minimum number of Lanczos vectors: in an iteration for modes, and in a search for further slow modes."""


def slowest_modes(dynamics: Dynamics, count: int, solve: LinearMap | None = None) -> Modes:
    """Compute the `count` slowest modes of a circuit; return them as Modes.

    If the number of rows is at most 200 or at most twice `count`, the result contains all modes.  `dynamics`: circuit
    equations; `solve`: function that multiplies a vector by ``G^-1``, None to create it (`accurate_solver`).
    """
    live = require_charge(dynamics)
    solve = solve or accurate_solver(factor_resolvent(dynamics, 0.0), dynamics.capacitance)
    if dynamics.size <= max(DENSE, 2 * count):
        return all_modes(dynamics)
    return _slowest(dynamics, min(count, live), live, solve)


def require_charge(dynamics: Dynamics) -> int:
    """Return the number of modes (finite time constants); raise InputError for a circuit without capacitance."""
    live = int(dynamics.charged.sum())
    if not live:
        raise InputError(
            "the circuit has no capacitance that could charge, so it has no time constants; "
            "give chip.capacitance, such as 50f, or a netlist with capacitors"
        )
    return live


def _slowest(dynamics: Dynamics, count: int, live: int, solve: LinearMap) -> Modes:
    """Compute the `count` slowest modes by Lanczos iteration on ``F G^-1 F^T``, with ``C = F^T F``, as Modes.

    The iteration is repeated until no slower mode remains.  `dynamics`: circuit equations; `live`: number of all modes;
    `solve`: function that multiplies a vector by ``G^-1``.
    """
    F = laplacian_root(dynamics.capacitance)

    def apply(u: Floats) -> Floats:
        return np.asarray(F @ solve(F.T @ np.ravel(u)))

    random = np.random.default_rng(0)
    tau, U = _top(apply, F @ random.uniform(0.5, 1.5, dynamics.size), count, _RTOL, _KRYLOV)
    while len(tau) < live:
        project = partial(_project_out, U)
        start = project(F @ random.uniform(0.5, 1.5, dynamics.size))

        def rest(u: Floats, project: LinearMap = project) -> Floats:
            return project(apply(project(np.ravel(u))))

        if _top(rest, start, 1, _PROBE_RTOL, _PROBE_KRYLOV)[0][0] * (1.0 + 2.0 * _PROBE_RTOL) < tau[count - 1]:
            break
        more, u = _top(rest, start, 1, _RTOL, _KRYLOV)
        tau, U = _sorted(np.append(tau, more), np.hstack([U, u]))
        if more[0] <= tau[count - 1]:
            break
    slow = tau[:count] > _RESOLVED * tau[0]
    tau, U = tau[:count][slow], U[:, :count][:, slow]
    return Modes(tau, np.stack([solve(F.T @ u) for u in U.T], axis=1) / tau, whole=False)


def _project_out(U: Floats, u: Floats) -> Floats:
    """Return the part of the vector `u` (m,) that is orthogonal to the orthonormal columns of `U` (m, k)."""
    return np.asarray(u - U @ (U.T @ u))


def _top(apply: LinearMap, start: Floats, count: int, rtol: float, least: int) -> tuple[Floats, Floats]:
    """Return the `count` largest eigenvalues (count,) of a symmetric operator, and their eigenvectors (m, count).

    The largest eigenvalue comes first.  `apply`: function from a vector (m,) to the product of the operator with it;
    `start` (m,): start vector; `rtol`: relative residual of an eigenpair at which the iteration stops; `least`: minimum
    number of Lanczos vectors.
    """
    from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

    n, vectors = len(start), max(2 * count + 1, least)
    if n <= vectors:
        tau, U = np.linalg.eigh(np.stack([apply(u) for u in np.eye(n)]))
        return _sorted(tau[-count:], U[:, -count:])
    operator = LinearOperator((n, n), matvec=apply, dtype=np.float64)
    try:
        tau, U = eigsh(operator, count, which="LA", v0=start, tol=rtol, ncv=vectors)
    except ArpackError as error:
        raise AccuracyError(f"the time constants did not converge: {error}") from error
    return _sorted(tau, U)


def _sorted(tau: Floats, U: Floats) -> tuple[Floats, Floats]:
    """Return eigenvalues `tau` (k,) and eigenvectors (columns of `U`, shape (m, k)), the largest eigenvalue first."""
    order = np.argsort(-tau, kind="stable")
    return tau[order], U[:, order]


def fastest_time_constant(dynamics: Dynamics) -> float:
    """Return the shortest time constant of a circuit in seconds, with a relative error of at most 1 %.

    The voltages of nodes without capacitance follow the others instantly; they have no time constant.
    """
    require_charge(dynamics)
    if dynamics.size <= DENSE:
        return float(all_modes(dynamics).tau[-1])
    charged, B = dynamics.charged, laplacian_root(dynamics.conductance)
    own, massless = B[:, charged], B @ dynamics.null_space
    charge = symmetric_factors(dynamics.capacitance.matrix[charged][:, charged])
    inner = symmetric_factors(massless.T @ massless) if massless.shape[1] else None

    def left(u: Floats) -> Floats:
        return u if inner is None else u - massless @ inner.solve(massless.T @ u)

    def apply(u: Floats) -> Floats:
        return np.asarray(left(own @ charge.solve(own.T @ left(np.ravel(u)))))

    start = own @ np.random.default_rng(0).uniform(0.5, 1.5, own.shape[1])
    return float(1.0 / _top(apply, start, 1, _FASTEST_RTOL, _KRYLOV)[0][0])
