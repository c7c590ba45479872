"""Renderer of triangles in space as images: parallel projection, hidden surfaces, shading and outlines."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians, sin
from typing import NamedTuple

import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

_LARGEST = 32
"""Largest width or height, in pixels, of a triangle whose pixels are tested directly; larger triangles are divided."""

_STEP = 4
"""For each triangle, a square block of pixels is tested; its side is rounded up to a multiple of this number."""

_AT_ONCE = 1 << 20
"""Largest number of pairs of a pixel and a triangle that are tested at once, which limits the memory."""

_OUTLINE = 0.55
"""Factor from 0 (black) to 1 by which the colours of pixels at the border of a body are multiplied."""

_LIGHT = np.array([-0.35, 0.45, 0.82])
"""Vector of length 1, to within 0.2 %, towards the light in the camera's frame: right, up, towards the camera."""

_AMBIENT = 0.62
"""Brightness of a surface parallel to the light, relative to the brightness of a surface that faces the light."""


@dataclass(frozen=True)
class Camera:
    """A parallel projection (orthographic camera), which shows equal lengths in parallel directions equally long.

    `azimuth`, `elevation`: direction from the scene to the camera, in degrees; the azimuth is measured from x towards
    y, the elevation from the horizontal plane.
    """

    azimuth: float = -55.0
    elevation: float = 24.0

    @property
    def rotation(self) -> NDArray[np.float64]:
        """Matrix (3, 3) whose rows are the directions to the right, upwards and away from the camera, in the world."""
        a, e = radians(self.azimuth), radians(self.elevation)
        return np.array(
            [
                [-sin(a), cos(a), 0.0],
                [-sin(e) * cos(a), -sin(e) * sin(a), cos(e)],
                [-cos(e) * cos(a), -cos(e) * sin(a), -sin(e)],
            ]
        )

    def seen(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points in the camera's frame (..., 3): to the right, upwards, and depth away from the camera.

        `points` (..., 3): in world coordinates; lengths keep their unit.
        """
        return np.asarray(points @ self.rotation.T)


@dataclass(frozen=True)
class Window:
    """Part of the picture plane that an image shows.

    `left`, `bottom`, `right`, `top`: limits to the right and upwards from the world's origin in the picture, in the
    unit of the world coordinates; `rows`: number of pixel rows.
    """

    left: float
    bottom: float
    right: float
    top: float
    rows: int

    @property
    def scale(self) -> float:
        """Number of pixels per unit of length of the world coordinates."""
        return self.rows / (self.top - self.bottom)

    @property
    def columns(self) -> int:
        """Number of pixel columns."""
        return max(round((self.right - self.left) * self.scale), 1)

    def pixels(self, seen: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points (..., 3) as column and row in pixels from the lower left corner, and depth.

        `seen` (..., 3): points in the camera's frame.
        """
        return np.asarray((seen - (self.left, self.bottom, 0.0)) * (self.scale, self.scale, 1.0))


class ImageLayer(NamedTuple):
    """Image of one group of bodies.

    `colour` (rows, columns, 3), uint8: shaded colours, bottom row first; `depth` (rows, columns), float32: distance
    along the view from the plane through the world's origin, positive away from the camera, in the unit of the world
    coordinates, infinite without a body; `opacity`: 0 to 1.
    """

    colour: NDArray[np.uint8]
    depth: NDArray[np.float32]
    opacity: float


def render(
    triangles: NDArray[np.float64],
    owner: NDArray[np.int64],
    colour: str | NDArray[np.float64],
    camera: Camera,
    window: Window,
    opacity: float,
) -> ImageLayer:
    """Return the shaded image of triangles, with dark outlines of bodies.

    `triangles` (n, 3, 3): corners in the world; `owner` (n,): number of the body to which each triangle belongs;
    `colour`: name of the colour of all triangles, or red, green and blue from 0 to 1 of each, shape (n, 3); `camera`,
    `window`: projection, and shown part of the picture plane; `opacity`: 0 to 1, stored in the result only.
    """
    seen = camera.seen(triangles)
    depth, face = _nearest(window.pixels(seen), window)
    normal = np.cross(seen[:, 1] - seen[:, 0], seen[:, 2] - seen[:, 0])
    length = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    # The third coordinate points away from the camera, and meshes may have either orientation.
    facing = normal * (np.where(normal[:, 2] > 0, -1.0, 1.0) / length)[:, None] * (1.0, 1.0, -1.0)
    light = _AMBIENT + (1 - _AMBIENT) * np.clip(facing @ _LIGHT, 0.0, 1.0)
    covered = face >= 0
    shade = light[face[covered]]
    shade[_outline(np.append(owner, -1)[face])[covered]] *= _OUTLINE
    pixels = np.zeros((*face.shape, 3), dtype=np.uint8)
    paint = np.array(to_rgb(colour)) if isinstance(colour, str) else colour[face[covered]]
    pixels[covered] = 255 * shade[:, None] * paint + 0.5
    return ImageLayer(pixels, depth, opacity)


def _outline(owner: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the mask of pixels of a body that have a neighbour outside this body, shape (rows, columns).

    `owner` (rows, columns): number of the body at each pixel, -1 for none.
    """
    edge = np.zeros(owner.shape, dtype=np.bool_)
    across, up = owner[:, 1:] != owner[:, :-1], owner[1:] != owner[:-1]
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= up
    edge[:-1] |= up
    return np.asarray(edge & (owner >= 0))


def composite(layers: list[ImageLayer]) -> NDArray[np.uint8]:
    """Return the image of layers that hide each other by depth, at half the resolution.

    The result (rows / 2, columns / 2, 4) has the colours red, green, blue and opacity from 0 to 255.
    """
    shape = layers[0].depth.shape
    depth = np.stack([layer.depth.ravel() for layer in layers])
    used = np.flatnonzero(np.isfinite(depth).any(axis=0))
    depth = depth[:, used]
    colour, opacity = np.stack([layer.colour.reshape(-1, 3)[used] for layer in layers]), np.isfinite(depth)
    opacity = opacity * np.array([layer.opacity for layer in layers], dtype=np.float32)[:, np.newaxis]
    order = depth.argsort(axis=0, kind="stable")
    image = np.zeros((shape[0] * shape[1], 4), dtype=np.float32)
    through = np.ones(len(used), dtype=np.float32)
    pixel = np.arange(len(used))
    for row in order:
        part = through * opacity[row, pixel]
        image[used, :3] += part[:, np.newaxis] * colour[row, pixel]
        through -= part
    image[used, 3] = 255 * (1.0 - through)
    return _halved(image.reshape(*shape, 4))


def _halved(image: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return an image (rows / 2, columns / 2, 4), RGBA from 0 to 255, of the means over blocks of 2 x 2 pixels.

    `image` (rows, columns, 4): red, green and blue multiplied by the opacity from 0 to 1, and opacity from 0 to 255.
    """
    rows, columns = image.shape[0] // 2, image.shape[1] // 2
    mean = image[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2, 4).mean(axis=(1, 3))
    mean[..., :3] /= np.maximum(mean[..., 3:] / 255, 1e-6)
    return np.asarray(np.round(mean.clip(0, 255)).astype(np.uint8))


def _nearest(corners: NDArray[np.float64], window: Window) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return the depth (infinite for none) and the index (-1 for none) of the nearest triangle of every pixel.

    `corners` (n, 3, 3): column, row and depth of the corners of triangles. Both results have the shape (rows, columns).
    """
    shape = (window.rows, window.columns)
    depth = np.full(shape[0] * shape[1], np.inf, dtype=np.float32)
    face = np.full(depth.size, -1, dtype=np.int64)
    parts, number = _divided(corners, np.arange(len(corners)), shape)
    low = np.floor(parts[..., :2].min(axis=1)).astype(np.int64)
    size = (np.ceil(parts[..., :2].max(axis=1)).astype(np.int64) - low).max(axis=1, initial=1)
    sides = -(-size // _STEP) * _STEP
    for side in np.unique(sides).tolist():
        own = np.flatnonzero(sides == side)
        step = max(_AT_ONCE // side**2, 1)
        for first in range(0, len(own), step):
            some = own[first : first + step]
            where, far, which = _covered(parts[some], low[some], side, shape)
            nearer = np.flatnonzero(far < depth[where])
            order = nearer[np.argsort(-far[nearer], kind="stable")]  # of equal pixels the last assignment holds
            depth[where[order]] = far[order]
            face[where[order]] = number[some[which[order]]]
    return depth.reshape(shape), face.reshape(shape)


def _divided(
    corners: NDArray[np.float64], number: NDArray[np.int64], shape: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the triangles in the window, divided until each is at most `_LARGEST` pixels wide and high.

    Triangles outside the window are dropped. Returns the corners (m, 3, 3) of the parts, and the index (m,) of the
    triangle to which each belongs. `corners` (n, 3, 3): column, row and depth of the corners; `number` (n,): index of
    each triangle; `shape`: number of rows and columns of the window.
    """
    small, index = [], []
    while len(corners):
        low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
        inside = np.all((high > 0) & (low < shape[::-1]), axis=1)
        corners, number, low, high = corners[inside], number[inside], low[inside], high[inside]
        large = (high - low).max(axis=1, initial=0.0) > _LARGEST
        small.append(corners[~large])
        index.append(number[~large])
        a, b, c = corners[large].swapaxes(0, 1)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        corners = (
            np.stack([(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]).transpose(2, 0, 1, 3).reshape(-1, 3, 3)
        )
        number = np.repeat(number[large], 4)
    return np.concatenate([*small, np.empty((0, 3, 3))]), np.concatenate([*index, np.empty(0, np.int64)])


def _covered(
    corners: NDArray[np.float64], low: NDArray[np.int64], side: int, shape: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int64]]:
    """Return flat pixel index, depth, and index of the triangle, each (m,), for each pixel that a triangle covers.

    `corners` (n, 3, 3): column, row and depth of the corners; `low` (n, 2): column and row of the lower corner of the
    block of `side` x `side` pixels that contains each triangle; `shape`: number of rows and columns of the window.
    """
    (x0, y0), (x1, y1), (x2, y2) = corners[..., :2].transpose(1, 2, 0)[..., None, None]
    column, row = low[:, 0, None, None] + np.arange(side)[:, None], low[:, 1, None, None] + np.arange(side)
    x, y = column + 0.5 - x0, row + 0.5 - y0
    twice = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    twice = np.where(np.abs(twice) < 1e-12, np.nan, twice)
    # Barycentric coordinates; NaN of triangles that are seen edge-on covers no pixel.
    second = x * ((y2 - y0) / twice) - y * ((x2 - x0) / twice)
    third = y * ((x1 - x0) / twice) - x * ((y1 - y0) / twice)
    covers = (second >= 0) & (third >= 0) & (second + third <= 1)
    covers &= (column >= 0) & (column < shape[1])
    covers &= (row >= 0) & (row < shape[0])
    inside = np.flatnonzero(covers)
    which, across, up = np.unravel_index(inside, covers.shape)
    depth = corners[which, 0, 2] + second.ravel()[inside] * (corners[:, 1, 2] - corners[:, 0, 2])[which]
    depth += third.ravel()[inside] * (corners[:, 2, 2] - corners[:, 0, 2])[which]
    return (low[which, 1] + up) * shape[1] + low[which, 0] + across, depth.astype(np.float32), which
