"""Plant, drivers and a contender, tick by tick: what the tests run instead of ``ClosedLoop``."""

from __future__ import annotations

from collections import deque

import numpy as np

from benchmarks.core.contender import load
from bridge.closed_loop import ClosedLoop
from bridge.loop.lockstep import PlantMonitor
from bridge.plants.config import LoopConfig
from bridge.plants.mujoco import MujocoPlant
from bridge.plants.start_up import hanging_command, release_loaded
from controllers.joints.joint_servo import JointServo
from models.config import default_config
from models.robot_model import RobotModel
from models.terrain import FLAT, Terrain
from models.types import CommandReply, JointCommand, Matrix, RobotState, SensorData, Vector


class PowerLog:
    """Recorded joint torques ``tau`` (n, nj) [N.m] and true velocities ``true_v`` (n, nv) [m/s, rad/s]."""

    def __init__(self) -> None:
        self._rows: list[tuple[Vector, Vector]] = []

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, truth: RobotState) -> None:
        """Keep one row."""
        self._rows.append((truth.tau.copy(), truth.v.copy()))

    def clear(self) -> None:
        """Forget every row."""
        self._rows.clear()

    @property
    def tau(self) -> Matrix:
        """Joint torques."""
        return np.array([row[0] for row in self._rows])

    @property
    def true_v(self) -> Matrix:
        """Velocities."""
        return np.array([row[1] for row in self._rows])


class ContenderLoop:
    """Plant, drivers and a contender, tick by tick; arguments and methods as of ``ClosedLoop``.

    When built and on ``reset`` the robot is held in its 'stand' posture, then controlled by the contender, and released
    when its feet bear its weight. ``contender`` is ``module:Class``; ``record_period_s`` is None for no log; ``faults``
    is empty, since a contender has no supervisor.

    Raises:
        ConfigError: The contender cannot be made.
        PoiseError: The feet of the held robot do not take its weight.
    """

    faults: tuple[str, ...] = ()

    def __init__(
        self,
        contender: str,
        robot: str | RobotModel = "g1",
        seed: int = 0,
        *,
        terrain: str | Terrain = FLAT,
        friction: float | None = None,
        payload_kg: float = 0.0,
        delay_s: float | None = None,
        record_period_s: float | None = None,
    ) -> None:
        self._contender = load(contender)
        self.robot = robot if isinstance(robot, RobotModel) else RobotModel.load(robot)
        self.plant = MujocoPlant(self.robot, seed=seed, terrain=terrain, friction=friction, payload_kg=payload_kg)
        self._config = default_config(LoopConfig, "bridge", "closed_loop")
        latency = self.robot.profile.sensors.latency
        delay = latency.sensors + latency.commands if delay_s is None else delay_s
        self._delay = round(delay / self.plant.period)
        self._record_ticks = 0 if record_period_s is None else max(round(record_period_s / self.plant.period), 1)
        self._monitor_ticks = max(round(self._config.supervise_period / self.plant.period), 1)
        self._monitor = PlantMonitor(self.plant, self._config)
        self._hang = hanging_command(self.robot)
        self._queue: deque[tuple[int, JointCommand]] = deque()
        self.log = PowerLog()
        self._seed = seed
        self.reset()

    @property
    def t(self) -> float:
        """Simulated time [s]."""
        return self.plant.t

    @property
    def truth(self) -> RobotState:
        """True state; for scoring only."""
        return self.plant.truth

    @property
    def fallen(self) -> bool:
        """Whether the robot has fallen, by the true state."""
        return self._monitor.fallen

    @property
    def fall_reason(self) -> str:
        """How; empty while it has not."""
        return self._monitor.reason

    @property
    def foot_slip(self) -> Vector:
        """Largest slide of each foot while it stood (2,) [m]."""
        return self._monitor.foot_slip

    def reset(self, seed: int | None = None) -> None:
        """Start over, with a new seed if given; ``PoiseError`` when the feet do not take the robot's weight."""
        self._seed = self._seed if seed is None else seed
        self.plant.reset(self._seed)
        self._servo = JointServo(self.robot)
        self._servo.arm()
        self._queue.clear()
        self.log.clear()
        self._torque: Vector | None = None
        self._tick = 0
        for _ in range(round(self._config.hang_time / self.plant.period)):
            self._servo.command(self._hang, self.t)
            self._drive(self.plant.read())
        self._contender.reset(self.robot, self._seed)
        self._servo.blend()
        self._monitor.reset()
        release_loaded(self.robot, self.plant, self._config, self.step)
        self._monitor.reset()

    def run(self, duration: float) -> None:
        """Run for a simulated time [s], rounded to ticks."""
        for _ in range(round(duration / self.plant.period)):
            self.step()

    def step(self) -> None:
        """One tick, as of ``ClosedLoop``."""
        sensors = self.plant.read()
        self._queue.append((self._tick + self._delay, self._contender.step(sensors, self.plant.period)))
        while self._queue and self._queue[0][0] <= self._tick:
            command = self._queue.popleft()[1]
            if self._contender.torque_controlled:
                self._torque = np.clip(command.tau, -self.robot.tau_max, self.robot.tau_max)
            else:
                self._servo.command(command, sensors.t)
        if self._queue and self._torque is None and self._contender.torque_controlled:
            self._servo.command(self._hang, sensors.t)  # until its first command arrives
        self._drive(sensors)
        self._tick += 1
        if self._tick % self._monitor_ticks == 0:
            self._monitor.update()
        if self._record_ticks and self._tick % self._record_ticks == 0:
            self.log.add(self.truth)

    def _drive(self, sensors: SensorData) -> None:
        """Drivers, or the torques as they are, and physics."""
        if self._torque is None:
            self.plant.write(self._servo.step(sensors.t, sensors.q, sensors.v, self.plant.period))
        else:
            self.plant.write(JointCommand.torque(self._torque))
        self.plant.step()

    def command(self, text: str) -> CommandReply:
        """Accepted without effect: a contender takes velocities only."""
        return CommandReply(True, f"'{text}' left to set_velocity")

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Walking velocity of the body [m/s, m/s, rad/s]."""
        self._contender.set_velocity(forward, left, turn)

    def apply_push(self, force: tuple[float, float, float] | Vector, duration: float, body: str = "base_link") -> None:
        """Push a body at its centre of mass; see ``MujocoPlant.apply_push`` for refusals."""
        self.plant.push(force, duration, body)


AnyLoop = ClosedLoop | ContenderLoop  # loop under test: poise's laws, or a contender
