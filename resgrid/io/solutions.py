"""Writers of operating points: arrays of a space's field, or tables of nodes and elements of other circuits."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.lattice import Lattice
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.io.tables import Views, suffix_of, write
from resgrid.planning.fields import Field
from resgrid.planning.lattice_fields import LatticeField, lattice_field
from resgrid.spice.power import ir_drop, power_balance
from resgrid.spice.run.rawfile import format_raw, raw_of


def write_solution(
    op: OperatingPoint | Field | LatticeField,
    file: str | os.PathLike[str],
    *,
    title: str = "resistor network",
    form: str = "binary",
    about: Mapping[str, Any] | None = None,
) -> Path:
    """Write the voltages, currents and powers of a circuit, or a field.  The file is written atomically.

    Parameters
    ----------
    op : OperatingPoint, Field or LatticeField
        Solution to write.
    file : path-like
        For a field or the circuit of a space, ``.npz``: arrays with one dimension per axis, ``potential`` (NaN in cells
        without a node), ``log_drop`` if it exists, ``cell`` (`Cell` codes), and for a field ``safe``, the mask of
        the direction-safe cells, if it has one.  Of a lattice other than "square", ``potential`` and ``log_drop`` have
        the shape of the lattice, and ``points`` (shape of the lattice, then one number per axis) are the world
        coordinates of its sites (the positions of nodes).  For any other circuit, ``.csv``: table of nodes, then
        elements; ``.json``, ``.npz``: the same values by name; ``.raw``: raw file for waveform viewers.  ``-`` is
        standard output (arrays of a space, otherwise the table).
    title : str
        First line of a raw file.
    form : {"binary", "ascii"}
        Encoding of a raw file.
    about : mapping, optional
        Further keys of a JSON file, placed first.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the suffix is unknown, the potential of a space's circuit is not defined, or the file cannot be written.

    Examples
    --------
    >>> op = rg.solve(rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))))
    >>> with np.load(rg.save(op, "solution.npz")) as arrays:
    ...     print({name: array.shape for name, array in arrays.items()})
    {'potential': (8, 8), 'log_drop': (8, 8), 'cell': (8, 8)}
    """
    return write(file, _views(op, title, form, about or {}), "a solution")


def check_solution_file(file: str | os.PathLike[str], *, of_space: bool) -> None:
    """Raise InputError if a solution cannot be written to a file of this name.

    `of_space`: whether the circuit was compiled from a space, whose solution needs ``.npz``; for other circuits
    ``.csv``, ``.json`` and ``.raw`` are possible, too.
    """
    suffix_of(file, ("arrays",) if of_space else ("table", "record", "arrays", "waveforms"), "a solution")


def solution_record(op: OperatingPoint, worst: int = 10) -> dict[str, Any]:
    """Return residual, powers, largest drops from the supply and largest source currents as a dictionary for JSON.

    Keys: ``kcl_residual``, a fraction of the current through the node; ``power`` (heat) and ``power_delivered`` in
    watts; ``power_imbalance``, a fraction of the sum of all magnitudes; ``floating_nodes`` (names); ``worst_drops``:
    list with ``node`` (name), and in volts ``voltage``, ``supply`` (nominal voltage of the node's power net) and
    ``drop`` (supply minus voltage); ``supplies``: list with ``name``, ``volts`` and ``amps`` of voltage sources;
    ``solver`` (method); ``seconds`` by stage.  `worst`: largest number of entries of both lists.
    """
    netlist = op.netlist
    drops, balance = ir_drop(op), power_balance(op)
    lowest = drops.worst(worst)
    return {
        "kcl_residual": op.kcl_residual,
        "power": op.power,
        "power_delivered": balance.delivered,
        "power_imbalance": balance.imbalance,
        "floating_nodes": netlist.names_of(op.floating),
        "worst_drops": [
            {"node": name, "voltage": op.voltage[i], "supply": drops.supply[i], "drop": drops.drop[i]}
            for name, i in zip(netlist.names_of(lowest), lowest.tolist(), strict=True)
        ],
        "supplies": _supplies(op, worst),
        "solver": op.method,
        "seconds": dict(op.seconds),
    }


def _supplies(op: OperatingPoint, count: int) -> list[dict[str, Any]]:
    """Return the `count` voltage sources with the largest currents, as dictionaries of ``name``, ``volts``, ``amps``.

    The order is by descending magnitude of the current; undetermined currents (NaN) come first.
    """
    amps = np.nan_to_num(np.abs(op.source_current), nan=np.inf)
    names = _names(op.netlist, "voltage source", "v", len(amps))
    order = np.argsort(-amps, kind="stable")[:count].tolist()
    return [{"name": names[i], "volts": op.netlist.source_volts[i], "amps": op.source_current[i]} for i in order]


def _views(op: OperatingPoint | Field | LatticeField, title: str, form: str, about: Mapping[str, Any]) -> Views:
    """Return functions without arguments that return the contents of a file of a solution, by name of the content.

    Names: ``arrays`` for NPZ; for a circuit without cells also ``table`` (CSV), ``record`` (JSON) and ``waveforms``
    (raw). `op`: solution; `title`: first line of a raw file; `form`: encoding of a raw file, "binary" or "ascii";
    `about`: further keys of a JSON file.
    """
    if isinstance(op, Field):
        arrays = {"potential": op.potential, "log_drop": op.log_drop, "cell": op.space.cell, "safe": op.safe}
        return {"arrays": lambda: {name: array for name, array in arrays.items() if array is not None}}
    if isinstance(op, LatticeField):
        return {"arrays": lambda: _lattice_arrays(op.lattice, op.potential, op.log_drop)}
    if op.netlist.lattice_map is not None:
        found = lattice_field(op)
        return {"arrays": lambda: _lattice_arrays(found.lattice, found.potential, found.log_drop)}
    if op.netlist.cell_map is not None:
        return {"arrays": lambda: _field_arrays(op)}
    return {
        "table": lambda: _table(op),
        "record": lambda: {**about, **solution_record(op), **_record(op)},
        "arrays": lambda: _arrays(op),
        "waveforms": lambda: format_raw(raw_of(op), title=title, form=form),
    }


def _field_arrays(op: OperatingPoint) -> dict[str, NDArray[Any]]:
    """Return the arrays of a space's circuit by name: potential, natural logarithm of the drop, and cell codes.

    All arrays have the shape of the space.  The logarithm is omitted if the circuit has no high rail.  In cells without
    a node, the potential and the logarithm are NaN.  Raises InputError for a circuit without a potential.
    """
    cell_map = op.netlist.cell_map
    if cell_map is None or op.potential is None:
        raise InputError(
            "the potential is defined for circuits with two rails, or one rail and a drive, but this circuit has more; "
            "write it as a deck"
        )
    per_node = {"potential": op.potential, "log_drop": op.log_drop}
    per_cell = {
        name: np.where(cell_map.node >= 0, value[cell_map.node], np.nan)
        for name, value in per_node.items()
        if value is not None
    }
    return {**per_cell, "cell": cell_map.space.cell}


def _lattice_arrays(
    lattice: Lattice, potential: NDArray[np.float64], log_drop: NDArray[np.float64] | None
) -> dict[str, NDArray[Any]]:
    """Return the arrays of a lattice's field by name: ``potential``, ``log_drop`` unless it is None, and two more.

    ``cell`` (shape of the space): `Cell` codes; ``points`` (shape of the lattice, then one number per axis): world
    coordinates of the sites (the positions of nodes).  `potential`, `log_drop`: values in the shape of the lattice.
    """
    sites = np.moveaxis(np.indices(lattice.shape), 0, -1)
    arrays = {"potential": potential, "log_drop": log_drop, "cell": lattice.space.cell}
    points = lattice.space.to_world(lattice.points(sites))
    return {name: array for name, array in arrays.items() if array is not None} | {"points": points}


def _table(op: OperatingPoint) -> dict[str, list[Any]]:
    """Return the columns of a table with one row per node, followed by one row per element; values in SI units.

    Columns: ``kind``, ``name``, ``first``, ``second`` (node names), ``value`` (ohms, volts or amperes), ``voltage`` (of
    a node, or of the first node minus that of the second), ``current`` (from the first to the second node), ``power``
    (dissipated).  For a node, all are None except kind, name and voltage.
    """
    nodes = _node_names(op)
    names = "kind", "name", "first", "second", "value", "voltage", "current", "power"
    rows: list[tuple[Any, ...]] = [
        ("node", name, None, None, None, volts, None, None)
        for name, volts in zip(nodes, op.voltage.tolist(), strict=True)
    ]
    for kind, columns in _elements(op).items():
        across = (op.voltage[columns["nodes"][:, 0]] - op.voltage[columns["nodes"][:, 1]]).tolist()
        rows += [
            (kind, name, nodes[first], nodes[second], value, volts, current, power)
            for (first, second), value, current, power, name, volts in zip(*_lists(columns), across, strict=True)
        ]
    return dict(zip(names, map(list, zip(*rows, strict=True)), strict=True))


def _record(op: OperatingPoint) -> dict[str, Any]:
    """Return the values of nodes and elements as a dictionary for JSON, with the keys ``voltages`` and ``elements``.

    ``voltages``: node voltages by node name; ``elements``: by kind and by name, dictionaries with the keys ``first``,
    ``second`` (node names), ``value``, ``current`` (from the first to the second node) and ``power`` (dissipated), in
    SI units.
    """
    nodes = _node_names(op)
    elements = {
        kind: {
            name: {"first": nodes[a], "second": nodes[b], "value": value, "current": current, "power": power}
            for (a, b), value, current, power, name in zip(*_lists(columns), strict=True)
        }
        for kind, columns in _elements(op).items()
    }
    return {"voltages": dict(zip(nodes, op.voltage.tolist(), strict=True)), "elements": elements}


def _arrays(op: OperatingPoint) -> dict[str, Any]:
    """Return arrays by name: ``node`` (names), ``voltage``, and the values of each kind of element.

    The name of an array of elements is the kind of element and the value, such as ``voltage_source_current``; the
    values are ``nodes``, ``value``, ``current``, ``power`` and ``name``.
    """
    arrays: dict[str, Any] = {"node": np.array(_node_names(op)), "voltage": op.voltage}
    for kind, columns in _elements(op).items():
        arrays |= {f"{kind.replace(' ', '_')}_{name}": column for name, column in columns.items()}
    return arrays


def _lists(columns: Mapping[str, NDArray[Any]]) -> list[list[Any]]:
    """Return the columns of a table as lists, in the order of the mapping, without their names."""
    return [column.tolist() for column in columns.values()]


def _elements(op: OperatingPoint) -> dict[str, dict[str, NDArray[Any]]]:
    """Return the columns of each kind of element, by kind and by name of the column.

    Kinds: ``"resistor"``, ``"voltage source"``, ``"current source"``.  Columns, in SI units: ``nodes`` (m, 2);
    ``value``: ohms, volts or amperes; ``current`` from the first to the second node; ``power``: dissipated, negative
    for a source that delivers power; ``name``.
    """
    netlist, balance = op.netlist, power_balance(op)
    columns = {
        "resistor": (netlist.resistor_nodes, 1 / netlist.conductance, op.resistor_current, balance.resistor_power),
        "voltage source": (netlist.source_nodes, netlist.source_volts, op.source_current, -balance.source_power),
        "current source": (
            netlist.current_nodes, netlist.current_amps, netlist.current_amps, -balance.current_source_power,
        ),
    }  # fmt: skip
    return {
        kind: {
            **dict(zip(("nodes", "value", "current", "power"), rest, strict=True)),
            "name": np.array(_names(netlist, kind, kind[0], len(rest[0])), dtype=np.str_),
        }
        for kind, rest in columns.items()
    }


def _names(netlist: Netlist, kind: str, letter: str, count: int) -> list[str]:
    """Return the names of `count` elements of one kind; elements without names are numbered from 1, such as ``r1``.

    `kind`: kind of element, such as ``"resistor"``; `letter`: first letter of a numbered name.
    """
    given = (netlist.element_names or {}).get(kind)
    return list(given) if given is not None else [f"{letter}{i + 1}" for i in range(count)]


def _node_names(op: OperatingPoint) -> list[str]:
    """Return the names of all nodes of a circuit, in the order of the node numbers, ground first."""
    return op.netlist.names_of(np.arange(op.netlist.node_count))
