"""The physics of a run alone: repeats its states with nothing but MuJoCo's step."""

from __future__ import annotations

import mujoco
import numpy as np

from models.types import Vector

#: All inputs of ``mj_step``, with the warm start of the contact solver and pushes
STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class BarePhysics:
    """Records the start and the controls of a part of a run, and repeats it in a separate state, ``data``.

    ``MujocoWorld`` makes ``mj_step`` in two halves, so ``replay`` passes the same states as long as only the actuators
    have acted since the tick before ``begin``. Its time is the least that a tick can take. ``ticks`` is the longest
    part.
    """

    def __init__(self, model: mujoco.MjModel, ticks: int) -> None:
        self._model, self.data = model, mujoco.MjData(model)
        self._start: Vector = np.zeros(mujoco.mj_stateSize(model, STATE))
        self._controls = np.zeros((ticks, model.nu))
        self._count = 0

    def begin(self, data: mujoco.MjData) -> None:
        """Record the start state."""
        mujoco.mj_getState(self._model, data, self._start, STATE)
        self._count = 0

    def note(self, data: mujoco.MjData) -> None:
        """Record the controls of a tick."""
        self._controls[self._count] = data.ctrl
        self._count += 1

    def rewind(self) -> None:
        """Return to the start."""
        mujoco.mj_setState(self._model, self.data, self._start, STATE)

    def replay(self) -> None:
        """Step through the recorded part, after ``rewind``."""
        model, data, step = self._model, self.data, mujoco.mj_step
        for controls in self._controls[: self._count]:
            data.ctrl[:] = controls
            step(model, data)
