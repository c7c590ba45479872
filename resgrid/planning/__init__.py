"""Planning: from an operating point to a field, streamlines, timed paths and their certificates."""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
