"""Reading decks and resistor networks.

The way of the data: `sources` reads files below a root, `lines` joins and strips them into cards by the `rules` of a
dialect, `collect` sorts cards into blocks (the deck and its subcircuits), `elements` evaluates cards (`numerals`,
`expressions`, `scopes`, `models`), `expand` puts subcircuits in place of their calls, and `assemble` makes arrays.
Runs of plain cards take a short cut through compiled loops (`bulk`, `kernels`) with the same result.  `edges`,
`circuitscape` and `rasters` read networks that are no decks.
"""

from resgrid.spice.reader.networks import network_deck, read_network
from resgrid.spice.reader.read import read_spice

__all__ = ["network_deck", "read_network", "read_spice"]
