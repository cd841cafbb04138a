"""Plant, drivers and a contender, tick by tick: what the tests run instead of ``ClosedLoop``."""

from __future__ import annotations

from collections import deque

import numpy as np

from benchmarks.contender import load
from bridge.closed_loop import ClosedLoop
from bridge.loop_config import LoopConfig
from bridge.monitor import PlantMonitor
from bridge.mujoco_plant import MujocoPlant
from bridge.start_up import ReleaseGate, hanging_command
from controllers.joint_servo import JointServo
from models.config import default_config
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.terrain import FLAT, Terrain
from models.types import CommandReply, JointCommand, Matrix, RobotState, SensorData, Vector


class PowerLog:
    """What the speed test reads of a run.

    Attributes:
        tau: Joint torques, a row each recorded tick (n, nj) [N.m].
        true_v: Velocities of the true state (n, nv) [m/s, rad/s].
    """

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
    """Plant, drivers and a contender, tick by tick; the arguments and what is not explained here: ``ClosedLoop``.

    When built and on ``reset`` the robot is held in its 'stand' posture, then given to the contender, and let go when
    its feet carry it.

    Args:
        contender: ``module:Class``.
        robot: Name of a profile, or a loaded robot.
        seed: Of the sensor noise.
        terrain: The ground.
        friction: Coulomb coefficient [-]; the profile's when None.
        payload_kg: Unknown mass [kg].
        delay_s: From a measurement to the arrival of its command [s]; the profile's when None.
        record_period_s: Between two rows of the log [s]; None for no log.

    Attributes:
        robot: The robot.
        plant: The simulated robot.
        log: Torques and velocities.
        faults: None: a contender has no supervisor.

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
        """Start over, as a new loop would; a seed replaces the present one.

        Raises:
            PoiseError: The feet of the held robot do not take its weight.
        """
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
        gate = ReleaseGate(self.robot, self._config)
        self._monitor.reset()
        while not gate.update(self.plant.load, self.plant.period):
            if gate.waited > self._config.settle_limit:
                raise PoiseError(
                    f"{self.robot.name} cannot be let go after {gate.waited:.1f} s: the feet carry {gate.load:.0f} N "
                    f"of {gate.weight:.0f} N"
                )
            self.step()
        self.plant.hold(False)
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
            self.plant.write(self._torque)
        self.plant.step()

    def command(self, text: str) -> CommandReply:
        """A contender knows no words: velocities tell it everything."""
        return CommandReply(True, f"'{text}' left to set_velocity")

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Walking velocity of the body [m/s, m/s, rad/s]."""
        self._contender.set_velocity(forward, left, turn)

    def apply_push(self, force: tuple[float, float, float] | Vector, duration: float, body: str = "base_link") -> None:
        """Push a body at its centre of mass; see ``MujocoPlant.apply_push`` for refusals."""
        self.plant.apply_push(force, duration, body)


AnyLoop = ClosedLoop | ContenderLoop
"""What the tests run: poise's own laws, or a contender."""
