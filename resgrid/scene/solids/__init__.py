"""Readers of obstacles in space: meshes, point clouds and OctoMaps."""
