"""What differs between circuit simulators, as data.

ngspice
-------
What its decks must respect, each learnt by experiment with ngspice 39:

- The first line of a file it is given is a title, whatever it says; in an included file it is not.  A full-line
  comment in front serves both.  A line that begins with ``*#`` is a command, not a comment.
- ``1M`` is a milliohm and ``1F`` a femto-anything: numbers are written plain.  They are read digit by digit, so a
  number of 17 digits arrives with an error of up to 2 units in the last place.
- Case is folded, and ``gnd`` is another name of node ``0``.
- A node that floats, if only behind a capacitor, makes the matrix singular.  ngspice then steps gmin and supplies,
  ends in a pseudo-transient, and reports a wrong answer (every node is a little off) with exit status 0.
- 0 ohm silently becomes 1 milliohm; smaller but positive values are kept.
- A loop of voltage sources ends without an answer, a second device of the same name without a run.
- A linear operating point is solved directly: ``gmin``, ``reltol``, ``abstol``, ``vntol``, ``pivtol`` and ``pivrel``
  change nothing (agreement is 1e-14 on uniform grids, 1e-10 where conductances span ten decades), ``rshunt`` ruins it
  (1e-6), ``noopiter`` goes the way of the floating node.  So no option is set but ``klu``, the faster matrix package
  of newer versions, which older ones ignore; their own takes 0.4 s for 64 x 64 cells, 11 s for 128 x 128.
- Printed numbers are cut to ``numdgt`` digits: only the binary raw file holds the voltages as they are.
  ``SPICE_ASCIIRAWFILE`` in the environment and a ``.spiceinit`` in the home folder can change what is written.
- In batch mode with a control block it may exit with status 1 after a perfect run: neither status says anything.
- A control block may run any shell command: no deck from elsewhere is simulated with one.
"""

from __future__ import annotations

from dataclasses import dataclass

from resgrid.errors import InputError


@dataclass(frozen=True)
class Dialect:
    """How one simulator wants its decks.

    Attributes
    ----------
    name : str
        What the user calls it.
    ground : str
        Name of the reference node.
    reserved : frozenset of str
        Legal words that mean something else as a node name.
    resistor, voltage_source, current_source, capacitor : str
        A line of each kind, for ``%``: element name, first node, second node, value in SI units.
    temperature_coefficients : str
        What is added to a resistor's line, for ``%``: ``tc1`` in 1/K, ``tc2`` in 1/K^2.
    end : str
        Last line of a deck.
    commands : str
        The second file, that includes the deck and asks for its operating point, for ``format``: ``deck``.
    """

    name: str
    ground: str
    reserved: frozenset[str]
    resistor: str
    voltage_source: str
    current_source: str
    capacitor: str
    temperature_coefficients: str
    end: str
    commands: str


_NGSPICE = Dialect(
    name="ngspice",
    ground="0",
    reserved=frozenset({"gnd"}),
    resistor="%s %s %s %r",
    voltage_source="%s %s %s %r",
    current_source="%s %s %s %r",
    capacitor="%s %s %s %r",
    temperature_coefficients=" tc1=%r tc2=%r",
    end=".end",
    commands=(
        "* operating point of {deck}\n"
        "* ngspice -n -b -r operating_point.raw {deck}.ngspice\n"
        '.include "{deck}"\n'
        ".options klu\n"
        ".op\n"
        ".end\n"
    ),
)

DIALECTS = {dialect.name: dialect for dialect in (_NGSPICE,)}


def dialect_named(name: str) -> Dialect:
    """Look a dialect up.

    Parameters
    ----------
    name : str
        One of `DIALECTS`.

    Returns
    -------
    Dialect

    Raises
    ------
    InputError
        If there is no such dialect; the message lists them.
    """
    if name not in DIALECTS:
        raise InputError(f"there is no SPICE dialect {name!r}; choose one of {', '.join(sorted(DIALECTS))}")
    return DIALECTS[name]
