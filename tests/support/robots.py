"""Robots for several tests."""

from __future__ import annotations

import resgrid as rg

BAR = rg.PolygonRobot(((-0.5, -0.1), (0.5, -0.1), (0.5, 0.1), (-0.5, 0.1)), turning_length=0.5)
"""A bar of 1 m x 0.2 m that rotates about its centre."""
