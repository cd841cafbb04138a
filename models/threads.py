"""Numerical libraries on one thread; nothing numerical is imported here, so that it comes early enough."""

import os

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Environment variables that hold numerical libraries to one thread; they must be set before numpy is imported."""


def use_one_thread() -> None:
    """Hold this process, where it has not imported numpy yet, and its children to one thread; the user's word wins."""
    for variable in THREAD_VARIABLES:
        os.environ.setdefault(variable, "1")
