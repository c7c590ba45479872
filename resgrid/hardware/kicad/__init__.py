"""KiCad 9 files as text: S-expressions, symbols, footprints, schematics, boards and projects."""
