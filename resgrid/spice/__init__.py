"""Decks: simulators as data (`dialects`), circuits read (`read`, `networks`) and written (`write`), run and checked.

`write` turns a netlist into a deck, its commands and its sidecar; `run` hands it to a simulator; `check` holds a
`circuit` against the electrical rules, foretells what simulators make of it, and compares what they found.
"""

import lazy_loader

__getattr__, _, _ = lazy_loader.attach(__name__, ["analyses"])
