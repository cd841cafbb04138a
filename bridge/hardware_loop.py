"""Drivers and control laws of a real robot with a simulated robot in one process, in lockstep; no ROS, no clock."""

from collections.abc import Callable
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from bridge.driver.drivers import HardwareDrivers
from bridge.driver.start_commands import StartState
from bridge.driver.startup import Startup
from bridge.loop.lockstep import PlantMonitor
from bridge.loop.log import LoopLog
from bridge.plants.base import HardwarePlant
from bridge.plants.config import LoopConfig
from bridge.plants.gantry import STEP, HangingRobot, StepLink
from bridge.plants.guard import SilenceGuard
from bridge.plants.ros2_control.commands import GUARD, command_codec
from bridge.plants.ros2_control.config import COMMAND, JOINTS
from bridge.plants.ros2_control.guard import ControlGuard
from bridge.plants.ros2_control.link import Message
from bridge.plants.ros2_control.plant import Ros2ControlPlant
from bridge.plants.ros2_control.simulated import ControlledRobot, DirectControlLink
from bridge.plants.unitree.codec import BUTTONS, PRESS_IT
from bridge.plants.unitree.guard import DampingGuard
from bridge.plants.unitree.plant import UnitreePlant
from bridge.plants.unitree.simulated import DirectLink, GantryRobot
from controllers.estimation.assembler import mean_sample
from controllers.stack import ControlStack, StackConfig
from models.config import default_config
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import Mode, SensorData


class Process(Enum):
    """Processes of a real robot's graph that take part in its control."""

    DRIVER = "driver"
    CONTROL = "control"
    GUARD = "guard"


SideT = TypeVar("SideT", bound=HangingRobot)
LinkT = TypeVar("LinkT", bound=StepLink)
PlantT = TypeVar("PlantT", bound=HardwarePlant)
GuardT = TypeVar("GuardT", bound=SilenceGuard)


class PlantLoop(Generic[SideT, LinkT, PlantT, GuardT]):
    """Closed loop. A tick is: state, estimate, command, drivers, robot; messages are the bytes of the protocol.

    Deterministic: the same arguments and calls give the same run. ``start`` performs the steps of the operator at the
    gantry. The processes of the real graph are modelled at their interfaces; ``running`` is the set of processes that
    are not killed or stopped. A guard watches the commands of the driver, as for a real robot.

    Args:
        marker: File that marks an unfinished run.
        robot: The robot of the control laws.
        side: The simulated robot.
        link: Connection from the plant to ``side``.
        make_plant: Creates the plant of a driver.
        make_guard: Creates the guard process.
        record_period: Time between two rows of ``log`` [s]; no log when None.
    """

    def __init__(
        self,
        marker: Path,
        robot: RobotModel,
        side: SideT,
        link: LinkT,
        make_plant: Callable[[], PlantT],
        make_guard: Callable[[], GuardT],
        record_period: float | None = None,
    ) -> None:
        self.robot = robot  #: The robot of the control laws
        self.side = side  #: The simulated robot; control laws must not read it
        self.marker = marker
        self.link, self._make_plant, self._make_guard = link, make_plant, make_guard
        self.restart_driver()
        self.restart_guard()
        self.running = set(Process)
        self.stack = ControlStack(self.robot, StackConfig(), period=self.plant.period)
        self.history: list[str] = []  #: States of the start, in order
        self.log = LoopLog(self.robot)
        self.events: list[tuple[float, str]] = []  #: Stamp [s] and text of commands and changes of mode
        self.monitor = PlantMonitor(self.side.plant, default_config(LoopConfig, "bridge", "closed_loop"))
        self._record_ticks = 0 if record_period is None else max(round(record_period / STEP), 1)
        self._first: list[SensorData] = []
        self._estimating = False
        self._mode = Mode.OFF  # mode of the drivers
        self._t = 0.0

    def restart_driver(self) -> None:
        """Replace the driver by a new process, without ``close`` of the old one, as if it was killed."""
        self.plant = self._make_plant()
        self.drivers = HardwareDrivers(self.plant, self.robot)

    def restart_guard(self) -> None:
        """Replace the guard by a new process."""
        self.guard = self._make_guard()

    @property
    def t(self) -> float:
        """Simulated time [s]."""
        return self.side.tick * STEP

    @property
    def startup(self) -> Startup:
        """The state machine of the start."""
        return self.drivers.startup

    @property
    def upright(self) -> bool:
        """Whether the base is above ``upright_height``."""
        return bool(np.isfinite(self.side.base).all() and self.side.base[2] > self.side.config.upright_height)

    @property
    def failure(self) -> str:
        """Why a robot off the rope does not stand by itself; empty if it does.

        Reasons are a fall by the true state, faults, or a state of the start other than ``stand``.
        """
        reasons = [self.monitor.reason, *self.stack.supervisor.faults]
        if self.startup.state is not StartState.STAND:
            reasons.append(f"{self.startup.state}: {self.startup.reason}")
        return "; ".join(filter(None, reasons))

    def step(self) -> None:
        """One tick."""
        for _ in range(self.side.ticks):
            self.link.step()
        if Process.DRIVER in self.running:
            self._drive()
        if Process.GUARD in self.running:
            self._watch()
        if not self.side.hooked:
            self.monitor.update()
        if not self.history or self.history[-1] != self.startup.state:
            self.history.append(str(self.startup.state))

    def _drive(self) -> None:
        """The driver's tick, with the control laws between ``read`` and ``act``."""
        sensors = self.drivers.read()
        if sensors.t > self._t and Process.CONTROL in self.running:
            if self.startup.armable:
                self._control(sensors, sensors.t - self._t)
            else:
                self._estimating = False
                self._first.clear()
            self._t = sensors.t
        self.drivers.act()

    def _hear(self, message: Any) -> None:
        """Pass a message of the link to the guard."""
        if Process.GUARD in self.running:
            self.guard.receive(message, self.t)

    def _watch(self) -> None:
        """The guard's tick."""
        if self.guard.beat_due(self.t):
            self.link.beat(self.guard.armed)
        command = self.guard.step(self.t)
        if command is not None:
            self.link.publish(command)

    def run(self, time: float) -> None:
        """Run for a simulated time [s]."""
        for _ in range(round(time / self.plant.period)):
            self.step()

    def command(self, text: str) -> None:
        """Send a text command that must be accepted; ``PoiseError`` names command and reason of a refusal."""
        reply = self.stack.command(text)
        self._note(f"{text}: {reply.reason}")
        if not reply.accepted:
            raise PoiseError(f"{text} refused: {reply.reason}")

    def until(self, condition: Callable[[], bool], limit: float) -> None:
        """Run until a condition is true; ``PoiseError`` after a time [s]."""
        for _ in range(round(limit / self.plant.period)):
            if condition():
                return
            self.step()
        raise PoiseError(
            f"state '{self.startup.state}' after {limit:g} s waits for {self.startup.waits_for or 'nothing'}"
            f"{self.startup.reason and f' ({self.startup.reason})'}; before: {', '.join(self.history)}"
        )

    def reach(self, state: StartState, limit: float = 20.0) -> None:
        """Run until the start has reached a state."""
        self.until(lambda: self.startup.state is state, limit)

    def start(self, to: StartState = StartState.STAND) -> None:
        """Run from hanging to a state of the start, by default to standing still; the rope stays tied and slack."""
        states = list(StartState)
        for state in states[states.index(StartState.GANTRY) : states.index(to) + 1]:
            self.reach(state)
            if state is to:
                break
            if state is StartState.GANTRY:
                self.startup.confirm_gantry()
            elif state is StartState.HANGING:
                self.startup.lower()
                self.side.rope_speed = self.side.config.lowering_speed
        if to is StartState.STAND:
            self.until(lambda: not self.startup.fading and self.stack.gait.settled, self.side.config.settle_limit)

    def unhook(self) -> None:
        """Untie the rope; falls are detected from now on."""
        self.side.hooked = False
        self.monitor.reset()

    def _control(self, sensors: SensorData, dt: float) -> None:
        if not self._estimating:
            self._first.append(sensors)
            if len(self._first) < self.side.config.listen_samples:
                return
            self.stack.reset(mean_sample(self._first))
            self._first.clear()
            self._estimating = True
            reply = self.stack.arm()
            if not reply.accepted:
                raise PoiseError(f"the supervisor refuses to arm: {reply.reason}")
            self._mode = Mode.STAND
            self.drivers.set_mode(self._mode)
            return
        command = self.stack.step(sensors, dt)
        if command is not None:
            self.drivers.command(command)
            self._record()
        mode = self.stack.supervise(sensors.t, hardware=self.plant.holds)
        if mode is not self._mode:
            self._mode = mode
            self.drivers.set_mode(mode)
            self._note(f"mode {mode.value}" + "".join(f": {fault}" for fault in self.stack.supervisor.faults))

    def _record(self) -> None:
        if self._record_ticks and self.side.tick % self._record_ticks == 0:
            plant, stack = self.side.plant, self.stack
            self.log.add(plant.truth, plant.com, stack.state, stack.result, stack.mode, stack.gait)

    def _note(self, text: str) -> None:
        self.events.append((self._t, text))


class HardwareLoop(PlantLoop[GantryRobot, DirectLink, UnitreePlant, DampingGuard]):
    """A robot behind Unitree's protocol.

    Args:
        marker: File that marks an unfinished run.
        laws: Profile of the control laws and drivers, by name or path.
        rate: Rate of states and commands [Hz].
        seed: Seed of the sensor noise and of random deviations.
        delay: Delay from a state to the effect of its command [ms].
        record_period: Time between two rows of ``log`` [s]; no log when None.
        options: Options of ``GantryRobot``.
    """

    def __init__(
        self,
        marker: Path,
        *,
        laws: str | Path = "g1_hardware",
        rate: float = 500.0,
        seed: int = 0,
        delay: int = 2,
        record_period: float | None = None,
        **options: Any,
    ) -> None:
        side = GantryRobot(rate=rate, seed=seed, **options)
        link, robot = DirectLink(side, delay), RobotModel.load(laws)
        self.tries_stop_button = True  #: Whether an operator tests the stop button on request
        if (hardware := robot.profile.hardware) is not None and hardware.mode_machine is not None:
            self._stop_button = BUTTONS.index(hardware.stop_buttons[0])
            side.mode_machine = hardware.mode_machine  # the type of robot of the control laws
        make_plant = partial(UnitreePlant, robot, rate=rate, marker=str(marker), link=link)
        super().__init__(marker, robot, side, link, make_plant, partial(DampingGuard, robot), record_period)
        link.receivers.append(self._hear)

    def step(self) -> None:
        """One tick; the stop button of the remote controller is tested when the start requests it."""
        asked = self.tries_stop_button and not self.plant.tried and PRESS_IT in self.startup.waits_for
        if asked:
            self.side.press(self._stop_button)
        super().step()
        if asked:
            self.side.press()


class Ros2ControlLoop(PlantLoop[ControlledRobot, DirectControlLink, Ros2ControlPlant, ControlGuard]):
    """A robot behind ros2_control.

    Args:
        marker: File that marks an unfinished run.
        laws: Profile of the control laws and drivers.
        robot: Profile of the simulated robot.
        seed: Seed of the sensor noise.
        delay: Delay from a state to the effect of its command [ms].
        settings: Options of the plant, as in ``bridge/config/ros2_control.yaml``.
    """

    def __init__(
        self,
        marker: Path,
        *,
        laws: str = "g1_hardware",
        robot: str = "g1",
        seed: int = 0,
        delay: int = 2,
        **settings: Any,
    ) -> None:
        side = ControlledRobot(robot, laws=laws, settings=settings, seed=seed)
        link, model = DirectControlLink(side, delay), RobotModel.load(laws)
        make_plant = partial(Ros2ControlPlant, model, marker=str(marker), link=link, **settings)
        make_guard = partial(ControlGuard, model, command_codec(model, side.settings, GUARD))
        super().__init__(marker, model, side, link, make_plant, make_guard)
        link.receivers.append(lambda data: self._hear((COMMAND, data)))
        link.state_receivers.append(self._on_state)

    def _on_state(self, message: Message) -> None:
        if message[0] == JOINTS:
            self._hear(message)
