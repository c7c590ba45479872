"""The ``[control]`` table: how a robot is driven by its field, and what happens to it on the way."""

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
    """How a robot is moved by its field, through obstacles that the map shows and others; see `resgrid.simulation`.

    Attributes
    ----------
    k : float or None
        Share of the Dirichlet field that is followed; by default the first that the scene asks for.
    speed : float or None
        Nominal speed, per second; by default a 20th of the longest axis.
    speed_limits : tuple of float or None
        Largest speed of each joint or coordinate of the world, per second: one for all, or one each.
    admittance : tuple of float or None
        What a contact force does to the velocity: one number, a diagonal, or a matrix row by row; by default the speed.
    response : str
        Whether a contact force turns the robot along the equipotential, or pushes it.
    friction : float
        Coefficient of Coulomb friction of all contacts, at most 1e6.
    learn : bool
        Whether what is touched is marked in the map.
    step : float
        Largest share of a cell that an axis moves by in a step.
    steps : int
        After so many the run is given up.
    bias : tuple of float
        Offset of the believed configuration: one for all axes, or one each.
    noise : tuple of float
        Largest random error of the believed configuration, anew in each step: one for all axes, or one each.
    seed : int
        Of all randomness.
    push : tuple of tuple of float
        Pushes: the time they start at, how long they last, and the generalised force, one entry per axis.
    pushes : int
        And so many at random.
    push_size : float
        Force of the random pushes.
    settle : str or None
        The grid settles while the robot moves: as a chip, or by sweeps; by default it has settled at once.
    pace : float
        Sweeps, or units RC of a chip, while the robot crosses a cell.
    announce : bool
        Whether hidden obstacles are put on the map at time 0, and the grid settles.

    Raises
    ------
    InputError
        If a value is impossible.

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

    def misfits(self, ndim: int) -> Iterator[tuple[tuple[str | int, ...], str]]:
        """What does not fit a space of so many axes, by key path."""
        for key in ("speed_limits", "bias", "noise"):
            count = len(getattr(self, key) or (0.0,))
            if count not in (1, ndim):
                yield (key,), f"needs 1 number for all, or one for each of the {ndim} axes, got {count}"
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
    """The symmetric positive definite matrix that one number, a diagonal, or its entries row by row stand for.

    Shapes: `admittance` (), (1,), (ndim,), (ndim**2,) or (ndim, ndim); returns (ndim, ndim), read-only.
    """
    try:
        matrix = np.array(admittance, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("an admittance must be numbers") from None
    if matrix.size == 1:
        matrix = matrix.item() * np.eye(ndim)
    elif matrix.shape == (ndim,):
        matrix = np.diag(matrix)
    elif matrix.shape in ((ndim**2,), (ndim, ndim)):
        matrix = matrix.reshape(ndim, ndim)
    else:
        raise InputError(
            f"an admittance of {' x '.join(map(str, matrix.shape))} numbers: give 1 number, {ndim}, or {ndim**2} for a "
            f"matrix of {ndim} x {ndim} row by row"
        )
    if not np.isfinite(matrix).all():
        raise InputError("the admittance must be finite")
    uneven = np.abs(matrix - matrix.T).max()
    if uneven > 1e-12 * np.abs(matrix).max():
        raise InputError(f"the admittance is not symmetric: entries across the diagonal differ by up to {uneven:g}")
    least = float(np.linalg.eigvalsh(matrix)[0])
    if not least > 0:
        raise InputError(
            f"the admittance is not positive definite (smallest eigenvalue {least:g}): it would push back against "
            "some forces, or not give way at all"
        )
    matrix.flags.writeable = False
    return matrix
