"""Decks: dialects, writer, electrical checks, and the outside simulator."""
