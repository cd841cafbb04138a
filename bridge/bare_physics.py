"""The physics of a run alone: the same states again, by nothing but MuJoCo's own step."""

from __future__ import annotations

import mujoco
import numpy as np

from models.types import Vector

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
"""All that decides what ``mj_step`` does, the warm start of the contact solver and pushes included."""


class BarePhysics:
    """Notes where a stretch of a run begins and what drives it, and steps it again in a state of its own.

    The physics of ``MujocoWorld`` are ``mj_step`` in two halves; so ``replay`` goes through the very same states, as
    long as nothing but the actuators has acted since the tick before ``begin``. What it takes is the least that a tick
    can.

    Args:
        model: The compiled model of the run.
        ticks: Most ticks of a stretch.

    Attributes:
        data: The state that ``replay`` leaves behind.
    """

    def __init__(self, model: mujoco.MjModel, ticks: int) -> None:
        self._model, self.data = model, mujoco.MjData(model)
        self._start: Vector = np.zeros(mujoco.mj_stateSize(model, STATE))
        self._controls = np.zeros((ticks, model.nu))
        self._count = 0

    def begin(self, data: mujoco.MjData) -> None:
        """A stretch begins at a state."""
        mujoco.mj_getState(self._model, data, self._start, STATE)
        self._count = 0

    def note(self, data: mujoco.MjData) -> None:
        """A tick of it is done; its controls are still there."""
        self._controls[self._count] = data.ctrl
        self._count += 1

    def rewind(self) -> None:
        """Go to the beginning of the stretch."""
        mujoco.mj_setState(self._model, self.data, self._start, STATE)

    def replay(self) -> None:
        """Step through the stretch, after ``rewind``."""
        model, data, step = self._model, self.data, mujoco.mj_step
        for controls in self._controls[: self._count]:
            data.ctrl[:] = controls
            step(model, data)
