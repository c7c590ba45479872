"""Planning: the pipeline from a scene to fields, streamlines, certificates, random walks and trajectories.

Planning may import `circuit`, `scene` and packages below them; it does not depend on chip effects, control, pictures or
result files.
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
