"""Exact solids of a robot's collision geometries, and its bodies: named solids with padded convex covers."""

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
"""Value of `Solid.kind` by the name of the geometry element in the URDF file."""


def solid_of(geometry: Geometry, pose: NDArray[np.float64], urdf: Path, packages: Sequence[Path], place: str) -> Solid:
    """Return the exact solid of a collision geometry in the frame of a joint, in metres.

    `pose`: pose (4, 4) of the link in the joint's frame; `urdf`: path of the URDF file; `packages`: folders in which
    ``package://`` addresses of meshes are searched; `place`: file and link, for messages. Raises InputError for a mesh
    that is not found or cannot be read.
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
    """Return the bodies of all links, one for every collision geometry, and the name of the link of every body.

    A body has the name of its link; a link with several geometries has numbered bodies: ``"hand[0]"``, ``"hand[1]"``.

    `frames`: for every link, the index of the joint whose frame carries it (-1 for none) and its pose (4, 4) in this
    frame; `packages`: folders in which ``package://`` addresses are searched; `padding`: distance in metres by which
    convex pieces are enlarged; `pieces`: maximum number of convex pieces of a mesh.
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
