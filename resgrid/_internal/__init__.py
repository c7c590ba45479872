"""Infrastructure without physics: validation, values, files, checkpoints, memory, executors, compiled kernels.

Modules of this package may import only `resgrid.errors` from the rest of resgrid.
"""
