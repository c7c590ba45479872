"""The ``[control]`` table: how a robot is driven by its field, and what happens to it on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, Len

from resgrid.errors import InputError
from resgrid.scene.quantities import Listed
from resgrid.scene.table import check_fields

Numbers = Annotated[tuple[float, ...], Len(1), Listed()]


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
        Coefficient of Coulomb friction of all contacts.
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
    """

    k: Annotated[float, Ge(0), Le(1)] | None = None
    speed: Annotated[float, Gt(0)] | None = None
    speed_limits: Numbers | None = None
    admittance: Numbers | None = None
    response: Literal["equipotential", "admittance"] = "equipotential"
    friction: Annotated[float, Ge(0)] = 0.2
    learn: bool = True
    step: Annotated[float, Gt(0), Le(0.5)] = 0.2
    steps: Annotated[int, Ge(1), Le(10_000_000)] = 50_000
    bias: Numbers = (0.0,)
    noise: Numbers = (0.0,)
    seed: Annotated[int, Ge(0)] = 0
    push: tuple[tuple[float, ...], ...] = ()
    pushes: Annotated[int, Ge(0), Le(10_000)] = 0
    push_size: Annotated[float, Ge(0)] = 2.0
    settle: Literal["chip", "jacobi", "sor"] | None = None
    pace: Annotated[float, Gt(0)] = 10.0
    announce: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        if min(self.noise, default=0.0) < 0.0:
            raise InputError(f"noise: must be at least 0, got {min(self.noise):g}")
