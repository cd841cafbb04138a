"""What a task of the whole-body QP is."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from controllers.qp.terms import Terms
from models.types import Matrix, Reference, Vector


class Task(Protocol):
    """An acceleration-level objective: ``minimise |W^1/2 (J a + drift - a*)|^2``.

    The wanted task acceleration is a feed-forward plus proportional and derivative feedback::

        a* = a_ff + kp * error + kd * error_rate

    Adding a task is one file: a class with these members, handed to ``WholeBodyController``.

    Attributes:
        name: Unique name, used in configuration and reports.
        weight: W, one entry per row (k,); zero switches a row off.
        active: False leaves the whole task out of this tick's problem.
    """

    name: str
    weight: Vector
    active: bool

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
        """Write the task's Jacobian (k, nv) and ``a* - drift`` (k,) into its rows of the stack.

        A task that need not repeat itself may override this.
        """
        jacobian[:] = self.jacobian(terms)
        np.subtract(self.acceleration(terms, reference), self.drift(terms), target)


def rows(value: float, count: int) -> Vector:
    """A weight or gain spread over the rows of a task (count,)."""
    return np.full(count, value)
