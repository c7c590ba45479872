"""Public names of `resgrid.hardware`."""
