"""Plan robot motions with a grid of resistors.

    a robot and its surroundings -> configuration space -> resistor netlist -> operating point -> field -> path

>>> import numpy as np
>>> import resgrid as rg
>>> cell = np.zeros((8, 8), dtype=np.uint8)
>>> cell[1:5, 4], cell[6, 1] = rg.Cell.OBSTACLE, rg.Cell.GOAL
>>> space = rg.ConfigurationSpace([rg.Axis("x", 0, 8, 8), rg.Axis("y", 0, 8, 8)], cell)
>>> field = rg.field(rg.solve(rg.compile_space(space)))
>>> str(rg.streamline(field, start=(0.5, 6.5)).outcome)
'reached'

Names are imported when they are first used, so that ``import resgrid`` costs nothing; `__init__.pyi` lists them all.
"""

from __future__ import annotations

from typing import Any

from resgrid._internal.public import attach
from resgrid._internal.values import show_with

_public, _, __all__ = attach(__name__, __file__)
__all__ += ["__version__"]
__all__.sort()


def __getattr__(name: str) -> Any:
    return _version() if name == "__version__" else _public(name)


def __dir__() -> list[str]:
    return __all__


def _picture(value: object) -> str | None:
    """Return the picture that a notebook shows for a value, as HTML; None for values without a picture.

    The module of the pictures is imported here, at the first picture, because lower packages must not import it.
    """
    from resgrid.plot.pictures import image_html

    return image_html(value)


show_with(_picture)


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("resgrid")
    except PackageNotFoundError:  # used from a source tree that was never installed
        return "0+unknown"
