"""Keeps the rows of a run while it grows, and makes the log of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.control.contact import Touch
from resgrid.control.log import ContactLog, Ending, Lesson, Mode, Run
from resgrid.control.plant import Plant
from resgrid.frame import Frame
from resgrid.planning.fields import Field
from resgrid.space import ConfigurationSpace

Vector = NDArray[np.float64]


class Recorder:
    """Rows of a run."""

    def __init__(self, ndim: int) -> None:
        self._ndim = ndim
        self._rows: list[tuple[float, Vector, Vector, Vector, Mode, Vector, Vector]] = []
        self._touches: list[tuple[int, Touch]] = []

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def last_mode(self) -> Mode:
        """Mode of the last row."""
        return self._rows[-1][4] if self._rows else Mode.STREAMLINE

    @property
    def first_believed(self) -> Vector:
        """Where the robot believed to be in the first row."""
        return self._rows[0][2]

    def add(
        self, time: float, configuration: Vector, believed: Vector, velocity: Vector, mode: Mode, felt: Touch | None,
        push: Vector,
    ) -> None:  # fmt: skip
        """Keep one step."""
        torque = np.zeros(self._ndim)
        if felt is not None and felt.pressing.any():
            torque = felt.torque
            self._touches.append((len(self._rows), felt))
        self._rows.append((time, configuration, believed, velocity, mode, torque, push))

    def run(
        self, ending: tuple[Ending, str], goal: int | None, lessons: tuple[Lesson, ...], space: ConfigurationSpace,
        field: Field, plant: Plant,
    ) -> Run:  # fmt: skip
        """The log of all rows, in the world."""
        frame = space.frame
        time, configuration, believed, velocity, mode, torque, push = zip(*self._rows, strict=True)
        places = np.array(configuration)
        penetration = plant.deepest(places)
        if penetration > 0.0:
            ending, goal = (Ending.ENTERED, f"the robot entered an obstacle by {penetration:.3g} m"), None
        return Run(
            ending=ending[0],
            message=ending[1],
            goal=goal,
            time=np.array(time),
            configuration=space.to_world(places),
            believed=space.to_world(believed),
            velocity=frame.turned_to_world(velocity),
            mode=np.array(mode, dtype=np.uint8),
            torque=frame.turned_to_world(torque),
            push=frame.turned_to_world(push),
            contacts=self._contacts(frame),
            lessons=lessons,
            space=space,
            field=field,
            penetration=penetration,
        )

    def _contacts(self, frame: Frame) -> ContactLog:
        def column(name: str, empty: NDArray[np.generic]) -> NDArray[np.generic]:
            return np.concatenate([empty, *(getattr(felt, name)[felt.pressing] for _, felt in self._touches)])

        steps = [np.full(int(felt.pressing.sum()), step) for step, felt in self._touches]
        pairs, numbers = np.empty((0, 2)), np.empty(0, dtype=np.int64)
        return ContactLog(
            step=np.concatenate([numbers, *steps]),
            point=frame.to_world(column("point", pairs)),
            normal=frame.turned_to_world(column("normal", pairs)),
            force=frame.turned_to_world(column("force", pairs)),
            gap=column("gap", np.empty(0)),  # type: ignore[arg-type]
            part=column("part", numbers),  # type: ignore[arg-type]
            body=column("body", numbers),  # type: ignore[arg-type]
            sticking=column("sticking", np.empty(0, dtype=np.bool_)),  # type: ignore[arg-type]
        )
