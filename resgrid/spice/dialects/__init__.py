"""The table of all dialects by name, the file name suffixes of decks, and the lookup of a dialect by its name.

A dialect is one record of data (`Dialect`) that describes how a simulator reads decks and requests analyses.

In all dialects except Spectre's, the first letter of a name states the kind of an element.  The module of each dialect
describes further rules and pitfalls.  Default sources: ngspice manual, chapter "Analyses and Output Control"; LTspice
help, "Dot Commands"; Xyce Reference Guide, chapter "Netlist Commands"; HSPICE Command Reference; Spectre Circuit
Simulator Reference, chapter "Analysis Statements"; for quirks also their mailing lists.  Only ngspice was run.
"""

from __future__ import annotations

from resgrid.errors import InputError, suggestion
from resgrid.spice.dialects.hspice import HSPICE
from resgrid.spice.dialects.ltspice import LTSPICE
from resgrid.spice.dialects.ngspice import NGSPICE
from resgrid.spice.dialects.record import Dialect
from resgrid.spice.dialects.spectre import SPECTRE
from resgrid.spice.dialects.xyce import XYCE

DIALECTS = {dialect.name: dialect for dialect in (NGSPICE, LTSPICE, XYCE, HSPICE, SPECTRE)}
"""All dialects by name, such as ``"ngspice"``."""

OWN_SUFFIXES = {item.reading.suffix: item.name for item in DIALECTS.values() if item.reading.suffix}
"""Name of the dialect by file name suffix, for the suffixes that only one dialect uses (``.scs`` of Spectre)."""

DECK_SUFFIXES = (".cir", ".sp", ".spice", ".ckt", ".net", ".cdl", *OWN_SUFFIXES)
"""File name suffixes, in lower case, of the files that are decks in any dialect."""


def dialect_named(name: str) -> Dialect:
    """Return the dialect with the name `name`; raise InputError for an unknown name."""
    if name not in DIALECTS:
        hint = suggestion(name, DIALECTS) or f"choose one of {', '.join(sorted(DIALECTS))}"
        raise InputError(f"there is no SPICE dialect {name!r}; {hint}")
    return DIALECTS[name]
