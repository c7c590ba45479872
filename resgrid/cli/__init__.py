"""The command line: parse, call the library, write, choose the exit code.

`entry` holds the group of verbs and turns errors into exit codes; each verb is a module of its own; `options` are
shared by all of them, and `job` is the way from a scene to chips, fields and paths that they share.
"""

from resgrid.cli.entry import main

__all__ = ["main"]
