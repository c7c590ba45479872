"""Pictures: functions that draw a value on matplotlib axes (`ax`) and return the axes; `save_figure` writes a file.

Only this package imports matplotlib.

>>> ax = rg.draw(rg.plan(rg.read_scene("examples/scenes/lesson.toml")).field)
>>> rg.plot.save_figure(ax, "field.png").name
'field.png'
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
