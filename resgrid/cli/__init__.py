"""The command line: parses arguments, calls the library, prints results and chooses the exit code.

Each subcommand is a module of its own.  `entry` has the group of subcommands and exits with the code of the result or
error; `options`, `terminal`, `scenes`, `decks` and `paths` contain the code that subcommands have in common.
"""

from resgrid.cli.entry import main

__all__ = ["main"]
