"""Reading decks.

The way of the data: `files` reads files below a root, `cards` joins lines into cards and cuts them into tokens by the
rules of a dialect, `collect` sorts cards into blocks (the deck and its subcircuits) by what `commands` say, `elements`
evaluates cards (`numerals`, `expressions`, `scopes`, `models`, `waveforms`, `spectre`), `subcircuits` puts subcircuits
in place of their calls, and `assemble` makes arrays.  Runs of plain cards take a short cut through compiled loops
(`plain`, `kernels`) with the same result.
"""
