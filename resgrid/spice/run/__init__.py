"""Running simulators, by the name that ``--engine`` takes."""

from __future__ import annotations

from collections.abc import Callable

from resgrid.errors import InputError
from resgrid.spice.run.eecircuit import simulate_eecircuit
from resgrid.spice.run.ngspice import SimulatorRun, simulate

SIMULATED = "ngspice"
"""The dialect that all of them read."""

ENGINES: dict[str, Callable[..., SimulatorRun]] = {"ngspice": simulate, "eecircuit": simulate_eecircuit}


def engine_named(name: str) -> Callable[..., SimulatorRun]:
    """Look up what finds the operating point of a deck's content, as `simulate` does."""
    if name not in ENGINES:
        raise InputError(f"there is no engine {name!r}; choose one of {', '.join(ENGINES)}")
    return ENGINES[name]
