"""Infrastructure without physics: validation, values, files, checkpoints, memory, executors, compiled kernels.

It may import only `resgrid.errors` of resgrid.
"""
