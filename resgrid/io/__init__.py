"""Paths, runs and solutions as files: a table, a record or arrays of each, one encoder a format."""
