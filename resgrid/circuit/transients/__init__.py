"""Transients: linear RC circuits (`linear`), and circuits with memristors (`memristors`, `memristive`)."""
