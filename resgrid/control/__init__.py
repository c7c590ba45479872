"""Harmonic control (Connolly & Grupen 1992, sections 3.4 and 5 to 7): velocities, contacts, learnt obstacles.

>>> controller = rg.control.make_controller(rg.plan(rg.read_scene("examples/scenes/lesson.toml")).field, speed=0.5)
>>> controller.command((0.5, 6.5), (0.0, 0.0)).round(3)
array([ 0.495, -0.071])
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
