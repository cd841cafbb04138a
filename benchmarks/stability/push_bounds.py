r"""What a linear inverted pendulum can take of a push, without and with steps.

A force F for a time ``T_p`` moves the DCM of a pendulum whose centre of pressure rests on the edge of its support, a
distance d ahead of the DCM before the push, to where it would come to rest on a point a distance D beyond that edge:

.. math:: F (1 - e^{-\omega T_p}) = m \omega^2 (d + D)

Without a step D is zero. With N steps of length ``l`` and time ``T``, the first of which begins with the push,

.. math:: D_N = (D_{N-1} + l_N) e^{-\omega T} = \sum_{k=1}^{N} l_k e^{-k \omega T}

References:
    Koolen et al.: Capturability-based analysis and control of legged locomotion, part 1, IJRR 2012, eq. 29: its
    ``d_N - r_max`` is ``D_N`` here.
"""

from __future__ import annotations

import math

import numpy as np

from models.constants import GRAVITY
from models.types import Vector
from planners.gait.config import GaitConfig


def ankle_bound(mass: float, height: float, distance: float, duration: float) -> float:
    """Largest force of ``duration`` [s] that the ankle strategy takes [N].

    ``height`` is the CoM above the soles [m], ``distance`` that of the centre of pressure to the edge of the support in
    the direction of the push [m]; with ``D_N`` added, the force is the largest that N steps take.
    """
    omega = math.sqrt(GRAVITY / height)
    return mass * omega**2 * distance / (1.0 - math.exp(-omega * duration))


def step_length(gait: GaitConfig, foot: int, direction: Vector) -> float:
    """How far from the stance sole a foot can be put along a direction (2,) of its frame [m]."""
    reach = gait.reach
    narrow, wide = (reach.width_min, reach.width_urgent) if foot == 0 else (-reach.width_urgent, -reach.width_min)
    corners = [(x, y) for x in (-reach.backward, reach.forward) for y in (narrow, wide)]
    return float(max(np.dot(corner, direction[:2]) for corner in corners))


def step_distance(gait: GaitConfig, omega: float, steps: int, direction: Vector) -> float:
    """``D_N`` of the better first foot [m]: how far beyond the edge N steps can bring the DCM to rest.

    ``omega`` is that of the pendulum [1/s], ``direction`` a unit vector in the frame of the soles (2,).
    """
    decay = math.exp(-omega * gait.timing.single_urgent)
    sums = []
    for first in range(2):
        lengths = [step_length(gait, (first + k) % 2, direction) for k in range(steps)]
        sums.append(sum(length * decay ** (k + 1) for k, length in enumerate(lengths)))
    return max(0.0, *sums)
