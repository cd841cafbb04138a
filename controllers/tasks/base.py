"""What a task of the whole-body QP is."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from controllers.qp.kernels_stack import PYTHON_TASK
from controllers.qp.terms import Terms
from models.types import Matrix, Reference, Vector


class Task(Protocol):
    """An acceleration-level objective: ``minimise |W^1/2 (J a + drift - a*)|^2``.

    The wanted task acceleration is a feed-forward plus proportional and derivative feedback::

        a* = a_ff + kp * error + kd * error_rate

    Adding a task is one file: a class with these members, handed to ``WholeBodyController``. Those of the package also
    have a ``kind``, by which ``kernels_stack.stack_tasks`` writes their rows without a call of theirs; a test holds
    both to each other.

    Attributes:
        name: Unique name, used in configuration and reports.
        weight: W, one entry per row (k,); zero switches a row off.
        active: False leaves the whole task out of this tick's problem.
        kind: Which compiled rows it has; ``PYTHON_TASK`` for those that ``stack`` writes.
        which: Body or foot of those rows.
    """

    name: str
    weight: Vector
    active: bool
    kind: int = PYTHON_TASK
    which: int = 0

    def error(self, terms: Terms, reference: Reference) -> Vector:
        """Wanted minus measured, in the space of the task (k,)."""
        ...

    def jacobian(self, terms: Terms) -> Matrix:
        """Derivative of the task velocity with respect to the generalised velocity (k, nv)."""
        ...

    def drift(self, terms: Terms) -> Vector:
        """Task acceleration at zero generalised acceleration (k,)."""
        ...

    def acceleration(self, terms: Terms, reference: Reference) -> Vector:
        """Wanted task acceleration a* (k,)."""
        ...

    def stack(self, terms: Terms, reference: Reference, jacobian: Matrix, target: Vector) -> None:
        """Write the task's Jacobian (k, nv) and ``a* - drift`` (k,) into its rows of the stack."""
        jacobian[:] = self.jacobian(terms)
        np.subtract(self.acceleration(terms, reference), self.drift(terms), target)


def rows(value: float, count: int) -> Vector:
    """A weight or gain spread over the rows of a task (count,)."""
    return np.full(count, value)
