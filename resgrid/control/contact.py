"""Rigid, frictional contact of a robot that is moved by velocities.

The robot obeys ``qdot = v + A sum_k J_k^T f_k`` with the admittance A, so contact is a complementarity problem at the
level of velocities (D. E. Stewart and J. C. Trinkle, Int. J. Numer. Methods Eng. 39 (1996) 2673; M. Anitescu and F. A.
Potra, Nonlinear Dynamics 14 (1997) 231): no stiffness to choose, and stable at any step.  The ends of axes are contacts
of the same problem.  Velocities keep gaps to first order; that no gap closes on the way is for the step to see to
(`resgrid.control.motion`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from resgrid.robots import Pose


@dataclass(frozen=True, eq=False)
class Touch:
    """Everything that touches the robot at one moment, and what it does.

    `point` (m, 2): on the obstacle, in metres; `on_robot` (m, 2): the robot's surface point that faces it; `normal`
    (m, 2): unit normal, out of the obstacle; `inward` (m, 2): direction into the obstacle from its point; `gap` (m,):
    in metres; `part, body` (m,): rigid part of the robot (of an arm, the link), number of the obstacle; `force` (m,
    2): on the robot; ``tau = J^T force``; `sticking` (m,): the force is inside the friction cone, and the point does
    not move; `torque` (ndim,): generalised force of all contacts together, mechanical stops included; `normal_torque`
    (ndim,): that of the obstacles' normal forces alone: it points away from them in configuration space, while a
    force that sticks just holds against the streamline; `velocity` (ndim,): of the robot, with the contacts;
    `solved`: whether forces were found. If not (rounding may lose them where axes differ by many powers of ten), the
    robot stands still, and no force is known.
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
    solved: bool

    def slowed(self, share: float) -> Touch:
        """The same for a command, and so velocity and forces, of a share of the size."""
        return replace(
            self,
            force=share * self.force,
            torque=share * self.torque,
            normal_torque=share * self.normal_torque,
            velocity=share * self.velocity,
        )

    @property
    def pressing(self) -> NDArray[np.bool_]:
        """Which contacts carry force, shape (m,)."""
        return np.asarray(np.any(self.force != 0.0, axis=1))


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Pairs of near points, and how fast their gaps close for unit velocities of the axes.

    `pairs` (n, 11): as `resgrid.control.contact_kernels.near_points` gives them; `normal_rows, tangent_rows` (n, ndim):
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
    """Rows of the contact Jacobians of near points.  Shapes: `pairs` (n, 11)."""
    from resgrid.control import contact_kernels

    ndim = pose.spin.shape[1]
    normal, tangent = np.empty((len(pairs), ndim)), np.empty((len(pairs), ndim))
    if len(pairs):
        contact_kernels.contact_rows(pairs, len(pairs), pose, normal, tangent)
    return Surroundings(pairs, normal, tangent)


def touch(
    around: Surroundings,
    touching: NDArray[np.bool_],
    velocity: NDArray[np.float64],
    admittance: NDArray[np.float64],
    friction: float,
    opening: NDArray[np.float64],
    stops: NDArray[np.float64] | None = None,
) -> Touch:
    """Contact forces, and the velocity they leave.

    Shapes: `touching` (n,), `velocity` (ndim,), `admittance` (ndim, ndim), `opening` (n,), `stops` (s, ndim).
    """
    pairs = around.pairs[touching]
    ends = np.empty((0, len(velocity))) if stops is None else stops
    count = len(pairs)
    rows = np.concatenate([around.normal_rows[touching], ends]), np.zeros((count + len(ends), len(velocity)))
    rows[1][:count] = around.tangent_rows[touching]
    target = np.zeros(count + len(ends))
    after, forces, solved = _resolved(*rows, target, velocity, admittance, friction)
    target[:count] = opening[touching]
    pushed = _resolved(*rows, target, velocity, admittance, friction) if solved and target.any() else None
    normal = pairs[:, 4:6]
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    own = forces[:count]
    at_rest = np.abs(rows[1][:count] @ after) <= 1e-6 * np.abs(rows[1][:count]) @ np.abs(velocity)
    return Touch(
        point=pairs[:, 2:4].copy(),
        on_robot=pairs[:, 0:2].copy(),
        normal=normal.copy(),
        inward=pairs[:, 9:11].copy(),
        gap=pairs[:, 6].copy(),
        part=pairs[:, 7].astype(np.int64),
        body=pairs[:, 8].astype(np.int64),
        force=own[:, :1] * normal + own[:, 1:] * tangent,
        sticking=np.asarray((own[:, 0] > 0.0) & at_rest & (np.abs(own[:, 1]) < friction * own[:, 0])),
        torque=forces[:, 0] @ rows[0] + forces[:, 1] @ rows[1],
        normal_torque=own[:, 0] @ rows[0][:count],
        velocity=pushed[0] if pushed is not None and pushed[2] else after,
        solved=solved,
    )


def _resolved(
    normal: NDArray[np.float64], tangent: NDArray[np.float64], target: NDArray[np.float64],
    velocity: NDArray[np.float64], admittance: NDArray[np.float64], friction: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:  # fmt: skip
    """Velocity with contacts, forces, and whether they solve the problem; of a unit admittance and velocity."""
    from resgrid.control import contact_kernels

    forces, after = np.zeros((len(normal), 2)), velocity.astype(np.float64)
    speed, give = float(np.abs(velocity).max(initial=0.0)) or 1.0, float(np.abs(admittance).max())
    after /= speed
    solved = not len(normal) or contact_kernels.resolve_contacts(
        normal, tangent, target / speed, admittance / give, friction, after, forces
    )
    if not solved:
        return np.zeros_like(after), np.zeros_like(forces), False
    return after * speed, forces * (speed / give), True
