"""Collision geometries of a URDF file as exact solids and bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.robots.convex import Body, Solid, SolidKind
from resgrid.robots.convex_cover import body_of
from resgrid.robots.mesh_files import read_mesh
from resgrid.robots.urdf.description import Description, Geometry
from resgrid.robots.urdf.files import locate

_KINDS: dict[str, SolidKind] = {
    "box": "box",
    "sphere": "ball",
    "cylinder": "cylinder",
    "capsule": "capsule",
    "mesh": "mesh",
}
"""Kinds of solids by the element of the URDF file."""


def solid_of(geometry: Geometry, pose: NDArray[np.float64], urdf: Path, packages: Sequence[Path], place: str) -> Solid:
    """Return the exact solid of a geometry in the frame of a joint.

    `pose`: pose (4, 4) of the link in the joint's frame; `place`: file and link, for messages.
    """
    points, triangles = np.empty((0, 3)), np.empty((0, 3), dtype=np.int32)
    if geometry.shape == "mesh":
        file = locate(geometry.mesh, urdf, packages, f"{place}: mesh")
        try:
            points, triangles = read_mesh(file)
        except InputError as error:
            raise InputError(f"{place}: mesh: {error}") from None
        points = points * geometry.scale
        if np.prod(geometry.scale) < 0:  # a reflection turns the triangles inside out
            triangles = triangles[:, ::-1].copy()
    return Solid(_KINDS[geometry.shape], geometry.size, pose @ geometry.placement, points, triangles)


def robot_bodies(
    robot: Description,
    frames: Mapping[str, tuple[int, NDArray[np.float64]]],
    packages: Sequence[Path],
    padding: float,
    pieces: int,
) -> tuple[list[Body], list[str]]:
    """Return the bodies of all links, and the link of every body.

    `frames`: joint and pose of every link; `padding`: metres added to every body; `pieces`: most convex pieces of a
    mesh.  A link with several geometries has numbered bodies: ``"hand[0]"``, ``"hand[1]"``.
    """
    bodies, owners = [], []
    for link, geometries in robot.links.items():
        joint, pose = frames[link]
        for number, geometry in enumerate(geometries):
            name = link if len(geometries) == 1 else f"{link}[{number}]"
            solid = solid_of(geometry, pose, robot.file, packages, f"{robot.file}: link {link!r}")
            bodies.append(body_of(name, joint, solid, padding=padding, pieces=pieces))
            owners.append(link)
    return bodies, owners
