"""From an operating point to a field, streamlines and their certificates."""
