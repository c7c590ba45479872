"""Readers of files with obstacles in space: meshes, point clouds and OctoMaps."""
