"""The sidecar of a deck with memristors: hashes, and the expected voltages and states at several times."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from resgrid._internal.files import read_bytes
from resgrid.circuit.transients.memristive import MemristiveTransient
from resgrid.errors import InputError
from resgrid.spice.write.sidecar import BLANK, PositiveNumber, digest, format_hashed, is_intact, sidecar_path

KIND = "memristive"
_MAX_BYTES = 2**28
"""Largest sidecar that is read, in bytes."""

TOLERANCE = 1e-3
"""Largest accepted error of a state (0 to 1), and of a voltage as a fraction of the span of the expected voltages.

The span is the largest minus the smallest expected voltage of all nodes at all times.
"""


class MemristorNames(NamedTuple):
    """Memristors of a deck.

    `number` (m,): indices among the memristors of the circuit; `state`: m names of the nodes whose voltage is the
    state; `ends`: m pairs of names of both nodes.
    """

    number: NDArray[np.int64]
    state: list[str]
    ends: list[list[str]]


class _Waves(BaseModel):
    """Expected values of one node, one per time of the sidecar: volts, or the state of a memristor (0 to 1)."""

    values: list[FiniteFloat]


class MemristiveSidecar(BaseModel):
    """Content of the sidecar of a deck with memristors, without informative keys.

    `intact`: whether the file is unaltered according to its own hash; `own_sha256`, `sha256`: hashes of the file and of
    the deck; `dialect`: name of the deck's dialect; `supply`: largest minus smallest expected voltage, in volts;
    `tolerance`: largest accepted error of a state, and of a voltage as a fraction of `supply`; `times`: times of the
    expected values, in seconds; `nodes`, `states`: expected voltages and states by name; `companions`: hash of the file
    of commands by the name of this file.
    """

    model_config = ConfigDict(strict=True, frozen=True)
    intact: bool = False
    schema_: Literal[1] = Field(alias="schema")
    kind: Literal["memristive"]
    own_sha256: str
    sha256: str
    dialect: str
    supply: PositiveNumber
    tolerance: PositiveNumber
    times: list[PositiveNumber]
    nodes: dict[str, _Waves]
    states: dict[str, _Waves]
    companions: dict[str, str]


def format_memristive_sidecar(
    name: str,
    text: str,
    commands: tuple[str, str],
    run: MemristiveTransient,
    nodes: dict[str, int],
    memristors: MemristorNames,
) -> str:
    """Return the text of the sidecar of a deck with memristors, one node or state per line.

    `name`, `text`: file name and content of the deck; `commands`: name of the dialect, and content of the file of
    commands; `run`: expected transient; `nodes`: netlist number of every node of the deck, by name; `memristors`:
    memristors in the deck.
    """
    law, circuit = run.circuit.law, run.circuit
    span = float(np.nanmax(run.voltage) - np.nanmin(run.voltage)) or 1.0
    head: dict[str, Any] = {
        "schema": 1,
        "kind": KIND,
        "own_sha256": BLANK,
        "deck": name,
        "sha256": digest(text.encode()),
        "dialect": commands[0],
        "companions": {f"{name}.{commands[0]}": digest(commands[1].encode())},
        "supply": span,
        "tolerance": TOLERANCE,
        "law": {
            "on_resistance": law.on_resistance,
            "off_resistance": law.off_resistance,
            "rate": law.rate,
            "window": law.window,
            "exponent": law.exponent,
        },
        "times": run.times.tolist(),
    }
    volts = [f'"{key}": {{"values": {run.voltage[:, node].tolist()}}}' for key, node in nodes.items()]
    states = [
        f'"{state}": '
        + json.dumps(
            {
                "between": ends,
                "polarity": int(circuit.polarity[number]),
                "values": run.state[:, number].tolist(),
            }
        )
        for number, state, ends in zip(*memristors, strict=True)
    ]
    return format_hashed(head, {"nodes": volts, "states": states})


def read_memristive_sidecar(deck: Path) -> MemristiveSidecar | None:
    """Return the sidecar of a deck with memristors, None if the deck has another sidecar or none.

    `deck`: path of the deck.  Raise InputError if the sidecar is damaged.
    """
    path = sidecar_path(deck)
    if not path.is_file():
        return None
    data = read_bytes(path, _MAX_BYTES)
    if f'"kind": "{KIND}"'.encode() not in data[:200]:
        return None
    try:
        sidecar = MemristiveSidecar.model_validate_json(data)
        waves = [*sidecar.nodes.values(), *sidecar.states.values()]
        if any(len(each.values) != len(sidecar.times) for each in waves):
            raise InputError(f"the sidecar {path} is damaged: values and times differ in length; write the deck again")
        return sidecar.model_copy(update={"intact": is_intact(data)})
    except ValidationError as error:
        problem = str(error).splitlines()[0]
        raise InputError(f"the sidecar {path} is damaged: {problem}; write the deck again") from error
