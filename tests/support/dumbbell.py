"""A robot outside of the package, as an example of the complete interface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

import resgrid as rg
from resgrid.robots import Pose, RigidPart


@dataclass(frozen=True)
class Dumbbell(rg.Robot):
    """Two discs on a massless bar, at (x, y, theta); an arc of theta is an angle of theta / (length / 2)."""

    length: float
    radius: float

    @property
    def turning_length(self) -> float:  # type: ignore[override]
        return self.length / 2

    def ends(self, configurations: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        angle = configurations[:, 2] / self.turning_length
        half = self.length / 2 * np.column_stack([np.cos(angle), np.sin(angle)])
        return [configurations[:, :2] - half, configurations[:, :2] + half]

    def parts(self, configurations: NDArray[np.float64]) -> list[RigidPart]:
        return [RigidPart(np.asarray(shapely.points(end)), self.radius) for end in self.ends(configurations)]

    def travel(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
        step = np.abs(end - start)
        return np.asarray(np.linalg.norm(step[:, :2], axis=1) + step[:, 2])

    def pose(self, configuration: NDArray[np.float64]) -> Pose:
        ends = np.concatenate(self.ends(configuration[np.newaxis]))
        return Pose.of_body(np.hstack([ends, ends]), self.radius, configuration, self.turning_length)
