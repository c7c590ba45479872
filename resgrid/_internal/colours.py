"""Colours with a fixed meaning for the pictures and the live page; this module imports no plotting library."""

from __future__ import annotations

HEIGHT = (
    "#fde725", "#dde318", "#b8de29", "#95d840", "#73d056", "#56c667", "#3bbb75", "#28ae80", "#1fa287",
    "#1f958b", "#23898e", "#287c8e", "#2e6f8e", "#33628d", "#3a538b", "#404588", "#463480",
)  # fmt: skip
"""Colours (``#rrggbb``) of equidistant voltages above the goal rail: yellow at the goal, dark blue far from the goal.

This is the viridis colour map (van der Walt & Smith 2015), which is perceptually uniform and safe for colour-blind
readers. Its darkest colours are left out because they resemble obstacles.
"""

GOAL = "#e8491d"
"""Colour of goals (``#rrggbb``): red, in contrast to the yellow cells around them."""

SURFACE = ("#7890a8", "#a9b4c0", "#d8d3c8", "#f3ecdc")
"""Colours (``#rrggbb``) of the surfaces of three-dimensional obstacles at equidistant z coordinates: dark grey-blue at
the lowest, pale at the highest.
"""
