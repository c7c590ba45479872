"""Map files: a reader for each format, and one table of formats."""
