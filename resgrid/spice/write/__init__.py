"""Deck writers: names, flat form, tiles, statements of analyses, sidecar and self-check deck."""
