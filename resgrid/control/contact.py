"""Rigid, frictional contact of a robot that is moved by velocities.

The robot obeys ``qdot = v + A sum_k J_k^T f_k`` with the admittance A, so contact is a complementarity problem at the
level of velocities (D. E. Stewart and J. C. Trinkle, Int. J. Numer. Methods Eng. 39 (1996) 2673; M. Anitescu and F. A.
Potra, Nonlinear Dynamics 14 (1997) 231): no stiffness to choose, stable at any step, and a link rests on an obstacle
instead of sinking in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.control.kinematics import Pose


@dataclass(frozen=True, eq=False)
class Touch:
    """Everything that touches the robot at one moment, and what it does.

    Attributes
    ----------
    point : ndarray of float64, shape (m, 2)
        On the obstacle, in metres.
    on_robot : ndarray of float64, shape (m, 2)
        The robot's surface point that faces it.
    normal : ndarray of float64, shape (m, 2)
        Unit normal, out of the obstacle.
    inward : ndarray of float64, shape (m, 2)
        Direction into the obstacle from its point.
    gap : ndarray of float64, shape (m,)
        In metres.
    part, body : ndarray of int64, shape (m,)
        Rigid part of the robot (of an arm, the link), number of the obstacle.
    force : ndarray of float64, shape (m, 2)
        On the robot; ``tau = J^T force``.
    sticking : ndarray of bool, shape (m,)
        The force is inside the friction cone, and the point does not move.
    torque : ndarray of float64, shape (ndim,)
        Generalised force of all contacts together.
    normal_torque : ndarray of float64, shape (ndim,)
        That of their normal forces alone: it points away from the obstacle in configuration space, while a force that
        sticks just holds against the streamline.
    velocity : ndarray of float64, shape (ndim,)
        Of the robot, with the contacts.
    """

    point: NDArray[np.float64]
    on_robot: NDArray[np.float64]
    normal: NDArray[np.float64]
    inward: NDArray[np.float64]
    gap: NDArray[np.float64]
    part: NDArray[np.int64]
    body: NDArray[np.int64]
    force: NDArray[np.float64]
    sticking: NDArray[np.bool_]
    torque: NDArray[np.float64]
    normal_torque: NDArray[np.float64]
    velocity: NDArray[np.float64]

    @property
    def pressing(self) -> NDArray[np.bool_]:
        """Which contacts carry force, shape (m,)."""
        return np.asarray(np.any(self.force != 0.0, axis=1))


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Pairs of near points, and how fast their gaps close for unit velocities of the axes.

    Attributes
    ----------
    pairs : ndarray of float64, shape (n, 11)
        As `resgrid.control.kernels.near_points` gives them.
    normal_rows, tangent_rows : ndarray of float64, shape (n, ndim)
        ``n . J`` and ``t . J``.
    """

    pairs: NDArray[np.float64]
    normal_rows: NDArray[np.float64]
    tangent_rows: NDArray[np.float64]

    @property
    def gap(self) -> NDArray[np.float64]:
        """In metres, shape (n,)."""
        return np.asarray(self.pairs[:, 6])


def surroundings(pose: Pose, pairs: NDArray[np.float64]) -> Surroundings:
    """Rows of the contact Jacobians of near points.

    Parameters
    ----------
    pose : Pose
    pairs : ndarray of float64, shape (n, 11)

    Returns
    -------
    Surroundings
    """
    from resgrid.control import kernels

    ndim = pose.spin.shape[1]
    normal, tangent = np.empty((len(pairs), ndim)), np.empty((len(pairs), ndim))
    if len(pairs):
        kernels.contact_rows(pairs, len(pairs), pose.shift, pose.spin, pose.pivot, normal, tangent)
    return Surroundings(pairs, normal, tangent)


def touch(
    around: Surroundings,
    touching: NDArray[np.bool_],
    velocity: NDArray[np.float64],
    admittance: NDArray[np.float64],
    friction: float,
    target: NDArray[np.float64],
) -> Touch:
    """Contact forces, and the velocity they leave.

    Parameters
    ----------
    around : Surroundings
    touching : ndarray of bool, shape (n,)
        Which pairs are in contact.
    velocity : ndarray of float64, shape (ndim,)
        Without contact.
    admittance : ndarray of float64, shape (ndim, ndim)
    friction : float
        Coefficient mu of Coulomb friction, not negative.
    target : ndarray of float64, shape (n,)
        Least speed at which each gap must open, in m/s; 0 to keep it.

    Returns
    -------
    Touch
    """
    from resgrid.control import kernels

    pairs, normal_rows = around.pairs[touching], np.ascontiguousarray(around.normal_rows[touching])
    tangent_rows = np.ascontiguousarray(around.tangent_rows[touching])
    forces, after = np.zeros((len(pairs), 2)), velocity.astype(np.float64)
    if len(pairs):
        kernels.resolve_contacts(
            normal_rows, tangent_rows, np.ascontiguousarray(target[touching]), admittance, friction, after, forces
        )
    normal = pairs[:, 4:6]
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    pressing = forces[:, 0] > 0.0
    slip = np.abs(tangent_rows @ after)
    at_rest = slip <= 1e-6 * np.abs(tangent_rows) @ np.abs(velocity)
    inside = np.abs(forces[:, 1]) < friction * forces[:, 0]
    return Touch(
        point=pairs[:, 2:4].copy(),
        on_robot=pairs[:, 0:2].copy(),
        normal=normal.copy(),
        inward=pairs[:, 9:11].copy(),
        gap=pairs[:, 6].copy(),
        part=pairs[:, 7].astype(np.int64),
        body=pairs[:, 8].astype(np.int64),
        force=forces[:, :1] * normal + forces[:, 1:] * tangent,
        sticking=np.asarray(pressing & at_rest & inside),
        torque=forces[:, 0] @ normal_rows + forces[:, 1] @ tangent_rows,
        normal_torque=forces[:, 0] @ normal_rows,
        velocity=after,
    )
