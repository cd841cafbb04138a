"""A start fed with made-up inputs, without a robot."""

from typing import Any

import numpy as np

from bridge.driver.start_commands import StartState
from bridge.driver.startup import StartInputs, Startup
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData, Vector

DT = 0.002


class Bench:
    """Feeds a start; the joints follow the stiff hold perfectly."""

    def __init__(self, model: RobotModel, **options: Any) -> None:
        self.model, self.startup = model, Startup(model, **options)
        self.q = model.posture("stand") + 0.3
        self.t = 0.0
        self.inputs: dict[str, Any] = {"vendor": "ai"}
        self.driver = JointCommand(model.posture("stand"), np.zeros(model.nj), np.full(model.nj, 3.0))

    def sensors(self, v: Vector | None = None) -> SensorData:
        zero = np.zeros(self.model.nj)
        velocity = zero if v is None else v
        return SensorData(self.t, self.q, velocity, zero, np.zeros(3), np.array([0, 0, 9.81]), np.full((2, 6), np.nan))

    def tick(self, v: Vector | None = None) -> JointCommand | None:
        self.t += DT
        self.startup.update(StartInputs(self.sensors(v), **self.inputs))
        command = self.startup.command(self.sensors(v), self.driver)
        if command is not None and command.kp is not None and command.kp.any():
            self.q = command.q
        return command

    def run(self, time: float) -> None:
        for _ in range(round(time / DT)):
            self.tick()

    def reach(self, state: StartState) -> None:
        """Through the normal sequence to a state."""
        steps = {
            StartState.GANTRY: lambda: self.run(1.1),
            StartState.RELEASE: self.startup.confirm_gantry,
            StartState.DAMP: lambda: (self.inputs.update(vendor=""), self.run(0.11)),
            StartState.PREPARE: lambda: self.run(1.1),
            StartState.HANGING: lambda: self.run(3.1),
            StartState.HELD: self.startup.lower,
            StartState.LOADED: lambda: (self.inputs.update(load=0.98), self.run(2.0)),
            StartState.STAND: lambda: (self.inputs.update(driven=True), self.tick()),
            StartState.RELAX: self.startup.relax,
        }
        passed = [StartState.LISTEN, *steps].index(self.startup.state)
        for reached, act in list(steps.items())[passed:]:
            if self.startup.state is state:
                return
            act()
            assert self.startup.state is reached, self.startup.waits_for
        assert self.startup.state is state
