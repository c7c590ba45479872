"""Infrastructure without physics: validation, values, files, checkpoints, memory, executors, compiled kernels."""
