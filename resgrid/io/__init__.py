"""Paths, runs, solutions and networks as files: what each is in a table, a record or arrays, and one encoder a format."""
