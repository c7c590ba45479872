"""Resistor networks in other formats than decks: edge lists, Circuitscape configurations, graphs and arrays."""
