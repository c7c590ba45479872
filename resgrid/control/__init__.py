"""Harmonic control (Connolly & Grupen 1992, sections 3.4 and 5 to 7): velocities, contacts, learning of obstacles."""
