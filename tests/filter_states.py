"""States and errors of the invariant filter, by their definitions."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from controllers.estimation.config import EstimatorConfig
from controllers.estimation.filter_kernels import SIZE, FilterState, ProcessNoise, predict
from models.config import default_config
from models.constants import GRAVITY

CONFIG = default_config(EstimatorConfig, "controllers", "estimator")
DT = 0.001
EXACT = np.zeros((2, 6, 6))
"""Noise of sole poses that are without."""
NOISELESS = ProcessNoise(np.zeros((2, 2)), np.zeros((2, 4)), np.zeros(4), EXACT)
FOOT_PLUS = np.array([6, 7, 8, 0, 1, 2])
FOOT_MINUS = [np.array([9, 10, 11, 15, 16, 17]), np.array([12, 13, 14, 18, 19, 20])]


class State(FilterState):
    """State of the filter, with its errors."""

    @classmethod
    def random(cls, rng: np.random.Generator) -> State:
        rotations = [np.ascontiguousarray(pin.exp3(rng.normal(size=3))) for _ in range(3)]
        vectors, soles, biases = rng.normal(size=(4, 3)), np.array(rotations[1:]), 0.1 * rng.normal(size=(2, 3))
        return cls.zero()._replace(rotation=rotations[0], vectors=vectors, soles=soles, biases=biases)

    def perturbed(self, error: np.ndarray) -> State:
        """``Exp(error) X``, biases plus error."""
        turn, jacobian = pin.exp3(error[:3]), pin.Jexp3(-error[:3])  # left Jacobian of phi = right one of -phi
        vectors = np.array([turn @ self.vectors[k] + jacobian @ error[3 + 3 * k : 6 + 3 * k] for k in range(4)])
        soles = np.array([pin.exp3(error[15 + 3 * k : 18 + 3 * k]) @ self.soles[k] for k in range(2)])
        biases = self.biases + error[21:].reshape(2, 3)
        return self._replace(rotation=turn @ self.rotation, vectors=vectors, soles=soles, biases=biases)

    def error_from(self, true: State) -> np.ndarray:
        """First-order error of this estimate (27,)."""
        turn = self.rotation @ true.rotation.T
        parts = [pin.log3(turn)]
        parts += [self.vectors[k] - turn @ true.vectors[k] for k in range(4)]
        parts += [pin.log3(self.soles[k] @ true.soles[k].T) for k in range(2)]
        return np.concatenate([*parts, (self.biases - true.biases).ravel()])

    def propagated(self, rate: np.ndarray, force: np.ndarray, covariance: np.ndarray | None = None) -> State:
        """One step without noise of measured ``rate`` and ``force``."""
        result = State(*self.copy())
        if covariance is not None:
            result = result._replace(covariance=covariance)
        predict(FilterState(*result), rate, force, DT, GRAVITY, NOISELESS)
        return result


def positive_definite(rng: np.random.Generator, n: int = SIZE) -> np.ndarray:
    root = rng.normal(size=(n, n))
    return root @ root.T + 0.1 * np.eye(n)
