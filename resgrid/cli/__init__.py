"""The command line: parse, call the library, write, choose the exit code."""
