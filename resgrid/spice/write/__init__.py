"""Writing decks: names, the flat form and tiles, statements of analyses, sidecar and companion."""
