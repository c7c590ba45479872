"""Files that a URDF file refers to: ``package://``, ``model://`` and ``file://`` addresses, and plain paths."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from urllib.parse import unquote, urlsplit

from resgrid.errors import InputError

_MAX_LISTED = 4
"""Largest number of folders or paths that a message lists; it states how many others there are."""


def locate(address: str, urdf: Path, packages: Sequence[Path], place: str) -> Path:
    """Return the path of an existing file that a URDF file refers to.

    A plain path is relative to the folder of the URDF file.  A package is searched in `packages` (folders that contain
    it or have its name), then in the folders above the URDF file, then in the environment variables
    ``ROS_PACKAGE_PATH`` and ``AMENT_PREFIX_PATH``.

    Parameters
    ----------
    address : str
        Address as written in the file.
    urdf : Path
        Path of the URDF file.
    packages : sequence of Path
        Folders to search for packages.
    place : str
        File and element, for messages.

    Raises
    ------
    InputError
        If the package or the file is not found, or the address has an unknown scheme.
    """
    scheme, separator, rest = address.partition("://")
    if not separator:
        return _existing([urdf.parent / address], address, place)
    if scheme == "file":
        return _existing([urdf.parent / unquote(urlsplit(address).path)], address, place)
    if scheme not in ("package", "model"):
        raise InputError(f"{place}: unknown scheme in {address!r}; use package://, file:// or a relative path")
    package, _, inner = rest.lstrip("/").partition("/")
    found = [folder for folder in _package_folders(package, urdf, packages) if folder.is_dir()]
    if not found:
        given = _listed([str(each) for each in packages]) or "none were given"
        raise InputError(
            f"{place}: package {package!r} of {address!r} was not found in packages ({given}), above the file or in"
            f" ROS_PACKAGE_PATH; add the folder that contains {package!r} to packages"
        )
    return _existing([folder / inner for folder in found], address, place)


def _package_folders(package: str, urdf: Path, packages: Sequence[Path]) -> Iterator[Path]:
    """Yield the folders in which a package can be, in the order of the search."""
    environment = [Path(each) for each in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if each]
    prefixes = [Path(each) / "share" for each in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if each]
    for folder in packages:
        yield from _within(folder, package)
    for folder in urdf.absolute().parents:
        yield from _within(folder, package)
    for folder in (*environment, *prefixes):
        yield from _within(folder, package)


def _within(folder: Path, package: str) -> Iterator[Path]:
    """Yield a folder if it has the name of a package, then in every case the folder's subfolder of this name.

    The paths may not exist. `package`: name of the package.
    """
    if folder.name == package or folder.resolve().name == package:
        yield folder
    yield folder / package


def _existing(candidates: Sequence[Path], address: str, place: str) -> Path:
    """Return the first path that exists; raise InputError with the tried paths otherwise.

    `address`, `place`: address as written in the file, and file and element, for the message.
    """
    for path in candidates:
        if path.exists():
            return path
    tried = _listed([str(path) for path in dict.fromkeys(candidates)])
    raise InputError(f"{place}: there is no file for {address!r}; tried {tried}; check the name and the folder")


def _listed(words: Sequence[str]) -> str:
    """Return the first four words, separated by commas, and the number of the others, if there are more."""
    more = f" and {len(words) - _MAX_LISTED} more" if len(words) > _MAX_LISTED else ""
    return ", ".join(words[:_MAX_LISTED]) + more
