"""Names that every simulator can bear: lower case, a letter first, letters, digits and underscores, unique."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

_LEGAL = re.compile(r"[a-z][a-z0-9_]*")
_ALL_LEGAL = re.compile(r"(?:[a-z][a-z0-9_]*\n)*")
_FOREIGN = re.compile(r"[^a-z0-9_]+")
_MAX_LENGTH = 200


def legal_names(wanted: Sequence[str], initial: str, reserved: Iterable[str] = ()) -> list[str]:
    """Names as close to the wanted ones as the rules allow.

    A name that is legal keeps itself, its first bearer going first; of the others, capitals are folded, foreign
    characters become ``_``, and a number is added where the result is taken.

    Examples
    --------
    >>> legal_names(["a", "A", "b 1", "7", "gnd"], "n", reserved=["gnd"])
    ['a', 'a_2', 'b_1', 'n_7', 'gnd_2']
    """
    taken = set(reserved)
    distinct = set(wanted)
    if len(distinct) == len(wanted) and taken.isdisjoint(distinct) and _ALL_LEGAL.fullmatch("\n".join([*wanted, ""])):
        return list(wanted)
    names: list[str] = []
    for name in wanted:
        keeps = name not in taken and len(name) <= _MAX_LENGTH and _LEGAL.fullmatch(name) is not None
        names.append(name if keeps else "")
        if keeps:
            taken.add(name)
    counters: dict[str, int] = {}
    for i, name in enumerate(names):
        if not name:
            names[i] = _free_name(_tidy(wanted[i], initial), taken, counters)
            taken.add(names[i])
    return names


def _tidy(name: str, initial: str) -> str:
    tidy = _FOREIGN.sub("_", name.lower())[:_MAX_LENGTH]
    return tidy if _LEGAL.fullmatch(tidy) else f"{initial}_{tidy}"


def _free_name(base: str, taken: set[str], counters: dict[str, int]) -> str:
    if base not in taken:
        return base
    number = counters.get(base, 2)
    while f"{base}_{number}" in taken:
        number += 1
    counters[base] = number + 1
    return f"{base}_{number}"
