"""Limit numerical libraries to one thread. Imports no numerical library, because the limit must be set before."""

import os

#: Environment variables with the thread counts of numerical libraries; set before numpy is imported
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def use_one_thread() -> None:
    """Limit this process and its children to one thread unless the user has set a number; call before numpy import."""
    for variable in THREAD_VARIABLES:
        os.environ.setdefault(variable, "1")
