"""Speed limits along paths, from the speed masks of a scene, by the rules of Nav2's SpeedFilter."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.scene.maps.mask_grids import MaskGrid, read_mask
from resgrid.scene.mask import Mask


class SpeedLimits(NamedTuple):
    """Speed limits of n points or segments.

    Both limits apply.  `fraction` (n,): largest fraction of the robot's largest speed, 1 without a limit; `speed` (n,):
    largest speed in units of the world per second, infinite without a limit.
    """

    fraction: NDArray[np.float64]
    speed: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Zone:
    """One speed mask.

    `grid`: its pixels; `limit` (width, height): speed limit of every pixel, infinite for none, first index along x,
    second along y, upwards; `is_percent`: whether limits are in percent of the robot's largest speed; otherwise they
    are in units of the world per second.
    """

    grid: MaskGrid
    limit: NDArray[np.float64]
    is_percent: bool


@dataclass(frozen=True, eq=False)
class SpeedZones:
    """The speed masks of a scene; `zones`: pixels and speed limits of each mask."""

    zones: tuple[_Zone, ...]

    def at(self, points: NDArray[np.float64]) -> SpeedLimits:
        """Return the limits at points (n, d) in world coordinates, whose first two coordinates are x and y.

        Where masks overlap, the smallest limit of each unit applies; outside all masks there is no limit.
        """
        fraction, speed = np.ones(len(points)), np.full(len(points), np.inf)
        for zone in self.zones:
            index = np.floor(zone.grid.pixels(points[:, :2])).astype(np.int64)
            inside = np.all((index >= 0) & (index < zone.limit.shape), axis=1)
            found = np.full(len(points), np.inf)
            found[inside] = zone.limit[tuple(index[inside].T)]
            if zone.is_percent:
                fraction = np.minimum(fraction, found / 100)
            else:
                speed = np.minimum(speed, found)
        return SpeedLimits(fraction, speed)

    def widened(self, distance: float) -> SpeedZones:
        """Return zones in which each pixel has the smallest limit of all pixels at most a distance away.

        The masks are enlarged by this distance on every side.  The zones hold for a motion that deviates from its path
        by at most `distance`.  `distance`: length in units of the world, rounded up to whole pixels; rows and columns
        count, so the pixels around a pixel form a square.
        """
        if not distance:
            return self
        return SpeedZones(tuple(_widened(zone, ceil(distance / zone.grid.spacing)) for zone in self.zones))

    def split(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64], SpeedLimits]:
        """Return a polyline divided where its speed limits change, and the limits of its segments.

        `points` (n, d): vertices in world coordinates, first x and y.  The result consists of the vertices (m, d), the
        number (m - 1,), from 0, of the original segment that contains each new segment, and the limits (m - 1,) of each
        new segment.  Segments without length are left out.
        """
        corners, origin = [points[:1]], []
        fraction, speed = [], []
        for number, (start, end) in enumerate(pairwise(points)):
            cuts = self._cuts(start, end)
            middle = start + ((cuts[:-1] + cuts[1:]) / 2)[:, np.newaxis] * (end - start)
            limits = self.at(middle)
            changes = np.flatnonzero(np.any([part[1:] != part[:-1] for part in limits], axis=0)) + 1
            first = np.concatenate([[0], changes])
            ends = np.concatenate([start + cuts[changes][:, np.newaxis] * (end - start), [end]])
            has_length = np.any(np.diff(ends, axis=0, prepend=start[np.newaxis]) != 0, axis=1)
            corners.append(ends[has_length])
            origin += [number] * int(has_length.sum())
            fraction.append(limits.fraction[first[has_length]])
            speed.append(limits.speed[first[has_length]])
        if not origin:
            return points, np.zeros(0, dtype=np.int64), SpeedLimits(np.zeros(0), np.zeros(0))
        return np.concatenate(corners), np.array(origin), SpeedLimits(np.concatenate(fraction), np.concatenate(speed))

    def _cuts(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return 0, 1 and the fractions of a segment at which the segment crosses borders of pixels, ascending, (n,).

        `start` (fraction 0), `end` (fraction 1), each (d,): ends of the segment in world coordinates; n is the number
        of different fractions.
        """
        cuts = [np.array([0.0, 1.0])]
        for zone in self.zones:
            low, high = zone.grid.pixels(np.array([start[:2], end[:2]]))
            for a, b, size in zip(low.tolist(), high.tolist(), zone.limit.shape, strict=True):
                borders = np.arange(max(ceil(min(a, b)), 0), min(max(a, b), size) + 0.5)
                if a != b and len(borders):
                    cuts.append((borders - a) / (b - a))
        return np.unique(np.clip(np.concatenate(cuts), 0.0, 1.0))


def speed_zones(masks: Sequence[Mask]) -> SpeedZones | None:
    """Return the speed zones of the speed masks among `masks`; None without a speed mask.

    The limit of a pixel is ``base + multiplier * occupancy`` of its mask.  As in Nav2, a pixel of occupancy 0 or -1
    (unknown) has no limit.  A limit of 0, below 0, or above 100 percent means no limit as well; a warning is issued for
    limits below 0 or above 100 percent.
    """
    zones = []
    for mask in masks:
        if mask.kind != "speed":
            continue
        grid = read_mask(mask.file, mask.dialect)
        limit = mask.base + mask.multiplier * grid.values.astype(np.float64)
        is_percent, given = mask.unit == "percent", grid.values > 0
        wrong = given & ((limit < 0) | (limit > 100 if is_percent else False))
        if wrong.any():
            warnings.warn(
                f"{mask.file}: {int(wrong.sum())} pixels have a speed limit out of range, such as "
                f"{limit[wrong][0]:g} {mask.unit}, and thus no limit; correct base and multiplier",
                stacklevel=2,
            )
        limit[~given | wrong | (limit == 0)] = np.inf
        zones.append(_Zone(grid, limit, is_percent))
    return SpeedZones(tuple(zones)) if zones else None


def _widened(zone: _Zone, pixels: int) -> _Zone:
    """Return a zone enlarged by a number of pixels on every side, with the smallest limit of the pixels around each."""
    from scipy.ndimage import minimum_filter

    limit = np.pad(zone.limit, pixels, constant_values=np.inf)
    limit = minimum_filter(limit, size=2 * pixels + 1, mode="constant", cval=np.inf)
    width = zone.grid.spacing * pixels
    axes = tuple(
        replace(axis, lower=axis.lower - width, upper=axis.upper + width, cells=axis.cells + 2 * pixels)
        for axis in zone.grid.axes
    )
    return _Zone(replace(zone.grid, axes=axes), limit, zone.is_percent)
