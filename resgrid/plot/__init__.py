"""Pictures: functions that draw a value on an ax and return the ax; `save_figure` writes a picture to a file.

Pictures may import the packages of the values that they draw; only this package may import matplotlib.
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
