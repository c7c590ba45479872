"""Decks: simulators as data (`dialects`), circuits read (`read`, `networks`) and written (`write`), run and checked.

`write` turns a netlist into a deck, its commands and its sidecar; `run` hands it to a simulator; `check` holds a
`circuit` against the electrical rules, foretells what simulators make of it, and compares what they found.
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
