"""Planning: the pipeline from a scene to fields, streamlines, certificates, random walks and trajectories."""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
