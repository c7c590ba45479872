"""The files that a solved deck is written to: CSV, JSON, NPZ, and raw files for waveform viewers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from resgrid.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from resgrid.cli.decks import SolvedDeck
    from resgrid.nodal.operating_point import OperatingPoint

Column = tuple[list[str], "NDArray[np.int32]", "NDArray[np.float64]", "NDArray[np.float64]", "NDArray[np.float64]"]


def solution_writer(target: str, form: str) -> tuple[str, Callable[[SolvedDeck, Path], None]]:
    """The writer for a file, by the end of its name."""
    suffix = ".csv" if target == "-" else Path(target).suffix.lower()
    writers: dict[str, Callable[[SolvedDeck, Path], None]] = {
        ".csv": _write_csv,
        ".json": _write_json,
        ".npz": _write_npz,
        ".raw": lambda solved, path: _write_raw(solved, path, form),
    }
    if suffix not in writers:
        raise InputError(f"-o {target}: a solved deck is written as {', '.join(writers)}; name the file so")
    return suffix, writers[suffix]


def _write_csv(solved: SolvedDeck, path: Path) -> None:
    """One row a node (its voltage), then one an element (nodes, value, voltage across it, current, power)."""
    point = solved.point
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write("kind,name,first,second,value,voltage,current,power\n")
        nodes = [_quoted(name) for name in _node_names(point)]
        file.write("".join([f"node,{n},,,,{v},,\n" for n, v in zip(nodes, _texts(point.voltage), strict=True)]))
        for kind, (names, ends, value, current, power) in _elements(point).items():
            across = point.voltage[ends[:, 0]] - point.voltage[ends[:, 1]]
            columns = zip(
                [_quoted(name) for name in names],
                ends[:, 0].tolist(),
                ends[:, 1].tolist(),
                _texts(value),
                _texts(across),
                _texts(current),
                _texts(power),
                strict=True,
            )
            rows = [f"{kind},{n},{nodes[a]},{nodes[b]},{x},{v},{i},{p}\n" for n, a, b, x, v, i, p in columns]
            file.write("".join(rows))


def _write_json(solved: SolvedDeck, path: Path) -> None:
    from resgrid.cli.decks import deck_data, solution_data
    from resgrid.cli.output import json_text

    point = solved.point
    names = _node_names(point)
    elements = {
        kind: {
            name: {"first": names[a], "second": names[b], "value": x, "current": i, "power": p}
            for name, (a, b), x, i, p in zip(
                labels, ends.tolist(), value.tolist(), current.tolist(), power.tolist(), strict=True
            )
        }
        for kind, (labels, ends, value, current, power) in _elements(point).items()
    }
    data = {
        **deck_data(solved.deck),
        **solution_data(solved, 10),
        "voltages": dict(zip(names, point.voltage.tolist(), strict=True)),
        "elements": elements,
    }
    path.write_text(json_text(data) + "\n", encoding="utf-8")


def _write_npz(solved: SolvedDeck, path: Path) -> None:
    import numpy as np

    arrays: dict[str, Any] = {"node": np.array(_node_names(solved.point)), "voltage": solved.point.voltage}
    for kind, (names, ends, value, current, power) in _elements(solved.point).items():
        key = kind.replace(" ", "_")
        arrays |= {f"{key}_name": np.array(names, dtype=np.str_), f"{key}_nodes": ends, f"{key}_value": value}
        arrays |= {f"{key}_current": current, f"{key}_power": power}
    with path.open("wb") as file:
        np.savez(file, **arrays)


def _write_raw(solved: SolvedDeck, path: Path, form: str) -> None:
    from resgrid.spice.run.rawfile import write_raw

    write_raw(solved.point, path, title=solved.deck.title or solved.deck.path, form=form)


def _elements(point: OperatingPoint) -> dict[str, Column]:
    """Per kind: names, nodes, values in SI units, currents from the first node to the second, power dissipated."""
    from resgrid.spice.power import power_balance

    netlist, balance = point.netlist, power_balance(point)
    return {
        "resistor": (
            _labels(point, "resistor", "r", len(netlist.conductance)),
            netlist.resistor_nodes,
            1 / netlist.conductance,
            point.resistor_current,
            balance.resistor_power,
        ),
        "voltage source": (
            _labels(point, "voltage source", "v", len(netlist.source_volts)),
            netlist.source_nodes,
            netlist.source_volts,
            point.source_current,
            -balance.source_power,
        ),
        "current source": (
            _labels(point, "current source", "i", len(netlist.current_amps)),
            netlist.current_nodes,
            netlist.current_amps,
            netlist.current_amps,
            -balance.current_source_power,
        ),
    }


def _labels(point: OperatingPoint, kind: str, letter: str, count: int) -> list[str]:
    given = (point.netlist.element_names or {}).get(kind)
    return list(given) if given is not None else [f"{letter}{i + 1}" for i in range(count)]


def _node_names(point: OperatingPoint) -> list[str]:
    import numpy as np

    return point.netlist.names_of(np.arange(point.netlist.node_count))


def _texts(values: NDArray[np.float64]) -> Iterator[str]:
    """Numbers as text, empty where there is none."""
    return ("" if math.isnan(value) else repr(value) for value in values.tolist())


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if any(letter in name for letter in ',"\r\n') else name
