"""Running simulators, by the name that ``--engine`` takes."""

from __future__ import annotations

from typing import Protocol

from resgrid.errors import InputError
from resgrid.spice.run.eecircuit import simulate_eecircuit
from resgrid.spice.run.ngspice import Simulation, simulate


class Engine(Protocol):
    """Finds the operating point of a deck's content."""

    def __call__(self, data: bytes, *, source: str = ..., timeout: float = ..., direct: bool = ...) -> Simulation:
        """Run it; see `resgrid.spice.run.ngspice.simulate`."""
        ...


SIMULATED = "ngspice"
"""The dialect that all of them read."""

ENGINES: dict[str, Engine] = {"ngspice": simulate, "eecircuit": simulate_eecircuit}


def engine_named(name: str) -> Engine:
    """Look an engine up."""
    if name not in ENGINES:
        raise InputError(f"there is no engine {name!r}; choose one of {', '.join(ENGINES)}")
    return ENGINES[name]
