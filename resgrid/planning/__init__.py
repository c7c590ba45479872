"""Planning: the pipeline from a scene to fields, streamlines, certificates, random walks and trajectories.

>>> walk = rg.planning.random_walk(rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))))
>>> round(float(rg.planning.collision_probability(walk).success[6, 2]), 6)
0.426282
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
