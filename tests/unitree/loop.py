"""The drivers and laws of a real robot against ``GantryRobot`` in one process, in lockstep: no ROS, no clock."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bridge.driver.drivers import HardwareDrivers
from bridge.driver.startup import StartState
from bridge.plants.unitree.plant import UnitreePlant
from controllers.estimation.assembler import mean_sample
from controllers.stack import ControlStack, StackConfig
from models.robot_model import RobotModel
from models.types import Mode, SensorData
from tests.unitree.robot import DirectLink, GantryRobot


class HardwareLoop:
    """One tick is: state, estimate, command, drivers, robot. ``operator`` stands for the person at the gantry."""

    def __init__(self, marker: Path, *, rate: float = 500.0, seed: int = 0, delay: int = 2, **options: Any) -> None:
        self.robot = GantryRobot(rate=rate, seed=seed, **options)
        self.link = DirectLink(self.robot, delay)
        model = RobotModel.load("g1_hardware")
        self.plant = UnitreePlant(model, rate=rate, marker=str(marker), link=self.link)
        self.drivers = HardwareDrivers(self.plant, model)
        self.stack = ControlStack(model, StackConfig(), period=self.plant.period)
        self._first: list[SensorData] = []
        self._estimating = False
        self._t = 0.0
        self.history: list[str] = []

    @property
    def startup(self) -> Any:
        return self.drivers.startup

    def step(self) -> None:
        for _ in range(self.robot.ticks):
            self.link.step()
        sensors = self.drivers.read()
        if sensors.t > self._t:
            if self.startup.armable:
                self._control(sensors, sensors.t - self._t)
            else:
                self._estimating = False
                self._first.clear()
            self._t = sensors.t
        self.drivers.act()
        if not self.history or self.history[-1] != self.startup.state:
            self.history.append(str(self.startup.state))

    def _control(self, sensors: SensorData, dt: float) -> None:
        if not self._estimating:
            self._first.append(sensors)
            if len(self._first) < 100:
                return
            self.stack.reset(mean_sample(self._first))
            self._first.clear()
            self._estimating = True
            reply = self.stack.arm()
            assert reply.accepted, reply.reason
            self.drivers.set_mode(Mode.STAND)
            return
        command = self.stack.step(sensors, dt)
        if command is not None:
            self.drivers.command(command)
        before = self.stack.mode
        mode = self.stack.supervise(sensors.t)
        if mode is not before:
            self.drivers.set_mode(mode)

    def run(self, time: float) -> None:
        for _ in range(round(time / self.plant.period)):
            self.step()

    def until(self, condition: Callable[[], bool], limit: float) -> None:
        for _ in range(round(limit / self.plant.period)):
            if condition():
                return
            self.step()
        raise AssertionError(f"state '{self.startup.state}' waits for {self.startup.waits_for}; {self.history}")

    def reach(self, state: StartState, limit: float = 20.0) -> None:
        self.until(lambda: self.startup.state is state, limit)

    def start(self) -> None:
        """From hanging under the vendor's controller to standing."""
        self.reach(StartState.GANTRY)
        self.startup.confirm_gantry()
        self.reach(StartState.HANGING)
        self.startup.lower()
        self.robot.rope_speed = 0.05
        self.reach(StartState.STAND)
        self.run(1.0)

    @property
    def upright(self) -> bool:
        return bool(np.isfinite(self.robot.base).all() and self.robot.base[2] > 0.6)
