"""Colours with one meaning in every picture and on the live page; numbers only, so that both can read them."""

from __future__ import annotations

HEIGHT = (
    "#fde725", "#dde318", "#b8de29", "#95d840", "#73d056", "#56c667", "#3bbb75", "#28ae80", "#1fa287",
    "#1f958b", "#23898e", "#287c8e", "#2e6f8e", "#33628d", "#3a538b", "#404588", "#463480",
)  # fmt: skip
"""Equidistant colours of a height above the goal, from the goal upwards: yellow at the goal, dark blue far from it.

They are viridis (van der Walt & Smith 2015), perceptually uniform and safe for colour-blind readers, without its
darkest colours, which resemble obstacles.
"""

GOAL = "#e8491d"
"""Red goals, which stand out from the yellow around them."""
