"""Writers of effective resistances between pairs of terminals: a table (CSV), a record (JSON), or arrays (NPZ)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from resgrid.circuit.effective_resistance import EffectiveResistance
from resgrid.io.tables import Views, suffix_of, write

_KIND = "effective resistances"


def write_resistances(value: EffectiveResistance, file: str | os.PathLike[str]) -> Path:
    """Write effective resistances.  The file is written atomically.

    Parameters
    ----------
    value : EffectiveResistance
        Resistances to write.
    file : path-like
        ``.csv``: one line per pair, with the names of both terminals and the resistance in ohms (``inf`` between
        different components); ``.json``: the same values, with the error bound; ``.npz``: the arrays ``matrix`` (of
        resistances between terminals, NaN if not requested) and ``pairs`` (indices of terminals).  ``-`` is standard
        output (the table).

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the suffix is unknown, or the file cannot be written.

    Examples
    --------
    >>> star = rg.Netlist(4, [[0, 1], [0, 2], [0, 3]], [1.0, 1.0, 1.0])
    >>> found = rg.effective_resistance(star, [(1, 2), (0, [1, 2])])
    >>> rg.save(found, "star.csv").read_text().splitlines()
    ['first,second,resistance', 'node_1,node_2,2.0', '0,node_1 node_2,0.5']
    """
    return write(file, _views(value, terminal_names(value)), _KIND)


def check_resistance_file(file: str | os.PathLike[str]) -> None:
    """Raise InputError unless a file of this name can hold effective resistances: ``.csv``, ``.json``, ``.npz``."""
    suffix_of(file, ("table", "record", "arrays"), _KIND)


def terminal_names(value: EffectiveResistance) -> list[str]:
    """Return the name of every terminal: the names of its first four nodes, as in ``a b c d and 3 more``.

    Blanks separate the names.  A terminal of at most four nodes has only the names.
    """
    names = []
    for nodes in value.terminals:
        shown = value.netlist.names_of(nodes[:4])
        names.append(" ".join(shown) + (f" and {len(nodes) - 4} more" if len(nodes) > 4 else ""))
    return names


def resistance_record(value: EffectiveResistance, names: list[str]) -> dict[str, Any]:
    """Return effective resistances as a dictionary for JSON.

    Keys: ``pairs`` (a list of dictionaries with the terminals' names ``first`` and ``second``, ``resistance`` in ohms,
    and ``connected``, whether it is finite), ``relative_error`` (bound) and ``solver`` (method).  `names`: names of the
    terminals.
    """
    pairs = [
        {"first": names[first], "second": names[second], "resistance": ohms, "connected": bool(np.isfinite(ohms))}
        for (first, second), ohms in zip(value.pairs.tolist(), value.resistance.tolist(), strict=True)
    ]
    return {"pairs": pairs, "relative_error": value.error, "solver": value.method}


def _views(value: EffectiveResistance, names: list[str]) -> Views:
    """Return functions that return the contents of a file: ``table`` for CSV, ``record`` for JSON, ``arrays`` for NPZ.

    `names`: names of the terminals.
    """
    return {
        "table": lambda: {
            "first": [names[number] for number in value.pairs[:, 0]],
            "second": [names[number] for number in value.pairs[:, 1]],
            "resistance": value.resistance,
        },
        "record": lambda: resistance_record(value, names),
        "arrays": lambda: {"matrix": value.matrix, "pairs": value.pairs},
    }
