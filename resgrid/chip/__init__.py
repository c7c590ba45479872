"""The chip: what real devices make of the circuit, and whether it is good enough to drive a robot."""

from importlib import import_module
from typing import Any

ANALYSES = ("yield", "precision", "settling", "noise", "power", "sensitivity", "exploration", "defects")
"""Every analysis, in the order of the report; see `resgrid.chip.report`."""


def __getattr__(name: str) -> Any:
    """The passes, loaded when they are asked for: the names above cost nothing."""
    if name == "passes":
        return import_module("resgrid.chip.passes")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
