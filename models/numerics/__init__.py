"""Numerical kernels: compilation, rotations, small matrices, hulls and threads."""
