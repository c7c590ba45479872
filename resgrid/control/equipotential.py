"""Motion along equipotentials while a contact force acts on the robot (Connolly & Grupen 1992, equation 1)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import NotNegative
from resgrid.errors import InputError

ALONG = 1e-3
"""Largest sine of the angle between contact force and streamline for which the robot counts as in a jam.

In a jam it cannot evade the contact along the equipotential.
"""


def equipotential_velocity(
    streamline_velocity: ArrayLike, force: ArrayLike, *, c: NotNegative = 1.0
) -> NDArray[np.float64]:
    """Return the velocity along the equipotential surface, to the side that a force points to.

    Equation (1) of Connolly & Grupen (1992), ``v_phi = c (v_psi x (f x v_psi))``, is ``c |v|^2 (I - v v^T / |v|^2) f``
    with ``v = v_psi`` in any number of dimensions.  So ``v_phi . v_psi = 0`` and ``v_phi . f >= 0``.  The velocity is 0
    where the force lies along the streamline; this rule cannot resolve such a jam.

    Parameters
    ----------
    streamline_velocity : array_like of float, shape (n,)
        ``v_psi``, along the streamline, in axis units per second.
    force : array_like of float, shape (n,)
        Generalised force ``f`` on the robot, in any unit.
    c : float
        Gain, not negative.

    Returns
    -------
    ndarray of float64, shape (n,)
        Velocity in axis units per second.

    Raises
    ------
    InputError
        If a value is not finite, the shapes differ, the gain is negative, or the result overflows.

    Examples
    --------
    >>> rg.control.equipotential_velocity((1.0, 0.0), (0.3, 0.5))
    array([0. , 0.5])
    >>> rg.control.equipotential_velocity((1.0, 0.0), (-0.5, 0.0))
    array([0., 0.])
    """
    v, f = np.asarray(streamline_velocity, dtype=np.float64), np.asarray(force, dtype=np.float64)
    if v.ndim != 1 or v.shape != f.shape:
        raise InputError(f"velocity and force need one entry per axis each, got shapes {v.shape} and {f.shape}")
    if not (np.isfinite(v).all() and np.isfinite(f).all()):
        raise InputError(f"velocity {v.tolist()} and force {f.tolist()} must be finite")
    with np.errstate(over="ignore", invalid="ignore"):
        velocity = c * _across(v, f)
    if not np.isfinite(velocity).all():
        raise InputError(
            f"velocity {v.tolist()} and force {f.tolist()} give a velocity that overflows: scale them, or c"
        )
    return velocity


def _across(v: NDArray[np.float64], f: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``|v|^2 f - v (v . f)``, shape (n,), for a velocity `v` (n,) and a force `f` (n,).

    This is ``|v|^2`` times the component of `f` perpendicular to `v`.  The antisymmetric matrix ``f v^T - v f^T`` makes
    the result exactly 0 for a force along the velocity.
    """
    turn = np.outer(f, v) - np.outer(v, f)
    return np.asarray(turn @ v)


def following_velocity(streamline_velocity: NDArray[np.float64], force: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the velocity along the equipotential to the side of a force, shape (n,), with the gain ``1 / (|v| |f|)``.

    `streamline_velocity` (n,): ``v``, per second; `force` (n,): generalised force ``f``.  The length of the result is
    the streamline speed times the sine of the angle between both vectors; the result is 0 for a sine of at most 1e-3.
    """
    speed, size = math.hypot(*streamline_velocity), math.hypot(*force)
    if speed == 0.0 or size == 0.0:
        return np.zeros_like(streamline_velocity)
    if math.isinf(size):
        return following_velocity(streamline_velocity, force / len(force))
    v, f = streamline_velocity / speed, force / size
    across = _across(v, f)
    return np.asarray(speed * across) if np.linalg.norm(across) > ALONG else np.zeros_like(v)
