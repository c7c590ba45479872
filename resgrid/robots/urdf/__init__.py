"""Robots that URDF files describe, and their configuration spaces with proven free cells.

The modules import pin, coal and trimesh (extra ``robots``) only when a robot is read or tested.
"""
