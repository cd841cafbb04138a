"""Numerical libraries on one thread; nothing numerical is imported here, so that it comes early enough."""

import os

#: Environment variables that hold numerical libraries to one thread; they must be set before numpy is imported
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def use_one_thread() -> None:
    """Limit this process, before it imports numpy, and its children to one thread, unless the user has set a number."""
    for variable in THREAD_VARIABLES:
        os.environ.setdefault(variable, "1")
