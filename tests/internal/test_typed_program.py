"""Type information of the package: the marker ``py.typed`` and the stub.  `make check` runs mypy on a program."""

from __future__ import annotations

from pathlib import Path

import resgrid


def test_the_package_is_marked_as_typed() -> None:
    folder = Path(resgrid.__file__).parent
    assert (folder / "py.typed").is_file()
    assert (folder / "__init__.pyi").is_file()
