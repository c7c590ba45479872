"""The command line: parse, call the library, write, choose the exit code.

`entry` holds the group of verbs, each a module of its own, and turns errors into exit codes; `options`, `terminal`,
`scenes`, `decks` and `paths` are shared by verbs.
"""

from resgrid.cli.entry import main

__all__ = ["main"]
