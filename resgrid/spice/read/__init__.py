"""Reader of SPICE decks: from files to a `Circuit`.

`deck` holds `read_spice` and runs the stages.  `files` reads files below a root folder.  `cards` joins lines into cards
(statements of a deck) and splits cards into tokens by the rules of a dialect.  `collector` sorts the cards into blocks
(the deck and its subcircuits) and applies `commands`.  `elements` evaluates the cards of elements, with `numerals`,
`expressions`, `scopes`, `models`, `waveforms`, `nonlinear_resistors` and `spectre`.  `subcircuits` expands instances,
and `assemble` builds the arrays.  `plain_cards` reads the common form ``name node node value`` of cards faster, with
the same result.
"""
