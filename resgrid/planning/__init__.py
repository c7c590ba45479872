"""Planning: the pipeline from a scene to fields, streamlines, certificates, random walks and trajectories."""
