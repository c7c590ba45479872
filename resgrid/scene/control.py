"""The ``[control]`` table: parameters of robot control by a harmonic field, and of disturbances."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.values import brief
from resgrid.errors import InputError
from resgrid.scene.quantities import Listed
from resgrid.scene.table_models import check_fields

Numbers = Annotated[tuple[float, ...], Len(1), Listed()]
Sizes = Annotated[tuple[Annotated[float, Ge(0)], ...], Len(1), Listed()]
Speeds = Annotated[tuple[Annotated[float, Gt(0)], ...], Len(1), Listed()]


@brief
@dataclass(frozen=True)
class Control:
    """Parameters of robot control by a harmonic field, with known and hidden obstacles; see `resgrid.simulation`.

    Attributes
    ----------
    k : float or None
        Weight of the Dirichlet field in the blend that the robot follows; by default the first ``k`` of the scene.
    speed : float or None
        Nominal speed, in axis units per second; by default a twentieth of the longest axis.
    speed_limits : tuple of float or None
        Largest speed of each joint or world coordinate, in axis units per second: one for all, or one per axis.
    admittance : tuple of float or None
        Matrix that maps a contact force to a velocity in axis units per second: one number for a multiple of the
        identity, a diagonal, or all entries row by row; by default the number ``speed``.
    response : {"equipotential", "admittance"}
        Response to a contact force: a turn along the equipotential, or a velocity by the admittance.
    friction : float
        Coefficient of Coulomb friction of all contacts, at most 1e6.
    learn : bool
        Whether touched obstacles are added to the map.
    step : float
        Largest displacement along an axis in one time step, as a fraction of a cell.
    steps : int
        Largest number of time steps of a run.
    bias : tuple of float
        Constant error of the estimated configuration, in axis units: one for all axes, or one per axis.
    noise : tuple of float
        Largest magnitude of the random error of the estimated configuration, in axis units; the error is uniform and
        drawn in every time step: one for all axes, or one per axis.
    seed : int
        Seed of all random numbers.
    push : tuple of tuple of float
        External forces, each as start time and duration, in seconds, and the generalised force, one entry per axis.
    pushes : int
        Number of additional external forces in random directions, at random times within the time T in which the robot
        could move along the longest axis; each lasts T / 20.
    push_size : float
        Euclidean norm of each random external force.
    settle : {"chip", "jacobi", "sor"} or None
        Model of a grid that settles while the robot moves: RC dynamics of a chip, or sweeps of a relaxation; by
        default the grid is always settled, or settles as a chip if ``announce`` is true.
    pace : float
        Number of sweeps, or of time constants RC of a chip, while the robot crosses a cell.
    announce : bool
        Whether hidden obstacles enter the map at time 0, at which the grid begins to settle by the model ``settle``;
        if false, only contacts add them to the map (see ``learn``).

    Raises
    ------
    InputError
        If a value is out of range.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml").replace(control=rg.control.Control(k=0.9, speed=2.0))
    >>> run = rg.simulation(scene).run()
    >>> str(run.ending), float(np.linalg.norm(run.velocity, axis=1).max().round(6))
    ('arrived', 2.0)
    """

    k: Annotated[float, Ge(0), Le(1)] | None = None
    speed: Annotated[float, Gt(0)] | None = None
    speed_limits: Speeds | None = None
    admittance: Numbers | None = None
    response: Literal["equipotential", "admittance"] = "equipotential"
    friction: Annotated[float, Ge(0), Le(1e6)] = 0.2
    learn: bool = True
    step: Annotated[float, Gt(0), Le(0.5)] = 0.2
    steps: Annotated[int, Ge(1), Le(10_000_000)] = 50_000
    bias: Numbers = (0.0,)
    noise: Sizes = (0.0,)
    seed: Annotated[int, Ge(0)] = 0
    push: tuple[Annotated[tuple[float, ...], Len(3)], ...] = ()
    pushes: Annotated[int, Ge(0), Le(10_000)] = 0
    push_size: Annotated[float, Ge(0)] = 2.0
    settle: Literal["chip", "jacobi", "sor"] | None = None
    pace: Annotated[float, Gt(0)] = 10.0
    announce: bool = False

    def __post_init__(self) -> None:
        check_fields(self)

    def problems(self, ndim: int) -> Iterator[tuple[tuple[str | int, ...], str]]:
        """Yield a pair of key path and message for every value that is inconsistent with a space of `ndim` axes.

        A key path is a tuple of names and indices below the table ``[control]``.
        """
        for key in ("speed_limits", "bias", "noise"):
            count = len(getattr(self, key) or (0.0,))
            if count not in (1, ndim):
                yield (key,), f"needs 1 number for all axes, or one for each of the {ndim} axes, got {count}"
        if self.admittance is not None:
            try:
                admittance_matrix(self.admittance, ndim)
            except InputError as error:
                yield ("admittance",), str(error)
        for number, (start, duration, *force) in enumerate(self.push):
            if len(force) != ndim:
                message = f"needs a time, a duration and a force of {ndim} entries, got {2 + len(force)} numbers"
                yield ("push", number), message
            if start < 0:
                yield ("push", number, 0), f"a push begins at a time of at least 0 s, got {start:g}"
            if duration <= 0:
                yield ("push", number, 1), f"a push lasts longer than 0 s, got {duration:g}"


def admittance_matrix(admittance: ArrayLike, ndim: int) -> NDArray[np.float64]:
    """Return the symmetric positive definite admittance matrix (ndim, ndim), which is read-only.

    The matrix maps a contact force to a velocity in axis units per second.  `admittance`: one number () or (1,) for a
    multiple of the identity; the diagonal (ndim,); or all entries row by row, (ndim**2,) or (ndim, ndim); `ndim`:
    number of axes.  Raises InputError for other shapes and for a matrix that is not symmetric positive definite.
    """
    try:
        matrix = np.array(admittance, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("the admittance must be a number or a list of numbers") from None
    if matrix.size == 1:
        matrix = matrix.item() * np.eye(ndim)
    elif matrix.shape == (ndim,):
        matrix = np.diag(matrix)
    elif matrix.shape in ((ndim**2,), (ndim, ndim)):
        matrix = matrix.reshape(ndim, ndim)
    else:
        raise InputError(
            f"the admittance has {' x '.join(map(str, matrix.shape))} numbers; give 1 number, {ndim} for a diagonal, "
            f"or {ndim**2} for a matrix of {ndim} x {ndim} row by row"
        )
    if not np.isfinite(matrix).all():
        raise InputError("the admittance must be finite")
    asymmetry = np.abs(matrix - matrix.T).max()
    if asymmetry > 1e-12 * np.abs(matrix).max():
        raise InputError(
            f"the admittance is not symmetric: entries differ from the transpose by up to {asymmetry:g}; make it "
            "symmetric"
        )
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if not smallest > 0:
        raise InputError(
            f"the admittance is not positive definite: its smallest eigenvalue is {smallest:g}; give a matrix with "
            "positive eigenvalues"
        )
    matrix.flags.writeable = False
    return matrix
