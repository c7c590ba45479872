"""Readers of map files, one per format, and the table of formats."""
