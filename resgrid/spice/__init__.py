"""Decks: dialects, writer, electrical checks, and the outside simulator.

The way of the data: `rules` judges a netlist, `deck` turns it into text in one of the `dialects` (`names` makes its
names legal), `files` writes deck and `sidecar`, `ngspice` runs the simulator and reads its `rawfile`, `agreement`
compares, and `locate` says where a deck is wrong.
"""

from resgrid.spice.ngspice import ngspice_version

__all__ = ["ngspice_version"]
