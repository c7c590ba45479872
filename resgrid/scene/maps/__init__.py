"""Readers of map files as cells of a grid, one module per format, and the table of the formats."""
