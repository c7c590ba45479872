"""Multigrid-preconditioned conjugate gradients: hierarchy, kernels, and the solver that drives them."""
