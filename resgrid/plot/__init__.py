"""Pictures: functions that draw a value on an ax and return the ax; `save_figure` writes a picture to a file.

Only this package imports matplotlib.

>>> ax = rg.draw(rg.plan(rg.read_scene("examples/scenes/lesson.toml")).field)
>>> rg.plot.save_figure(ax, "field.png").name
'field.png'
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
