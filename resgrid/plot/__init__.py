"""Pictures: functions that take a value and an axes, draw, and return the axes; `save_figure` writes a file.

Only this package imports matplotlib.
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
