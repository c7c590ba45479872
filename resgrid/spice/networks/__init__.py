"""Resistor networks that are no decks: lists of edges, Circuitscape's configurations, graphs and arrays."""
