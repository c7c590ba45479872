"""Decks: dialects, writer, electrical checks, and the outside simulator.

The way of the data: `rules` judges a netlist; `elements` chooses and names what a deck holds, `deck` makes flat text
of it in one of the `dialects` (`text` does so in bulk), `tiles` and `cells` an array of tiles with a pattern;
`analyses` are asked for, `requests` words them; `writer` writes deck, commands, `sidecar` and `companion`; `ngspice`
runs the simulator and reads its `rawfile`, `agreement` compares, and `locate` says where a deck is wrong.  `reader`
reads decks.
"""

from resgrid.spice.ngspice import ngspice_version

__all__ = ["ngspice_version"]
