"""The table of engines (programs that simulate decks) from which the option ``--engine`` selects, and its lookup."""

from __future__ import annotations

from collections.abc import Callable

from resgrid.errors import InputError
from resgrid.spice.run.eecircuit import simulate_eecircuit
from resgrid.spice.run.ngspice import SimulatorRun, simulate

SIMULATED = "ngspice"
"""Name of the dialect that all engines (programs that simulate decks) read."""

ENGINES: dict[str, Callable[..., SimulatorRun]] = {"ngspice": simulate, "eecircuit": simulate_eecircuit}
"""Function that runs an engine on a deck's content and returns the operating point, by the name of the engine."""


def engine_named(name: str) -> Callable[..., SimulatorRun]:
    """Return the function that runs an engine on a deck's content; raise InputError for an unknown engine."""
    if name not in ENGINES:
        raise InputError(f"there is no engine {name!r}; choose one of {', '.join(ENGINES)}")
    return ENGINES[name]
