"""Public names of `resgrid.processes`."""
