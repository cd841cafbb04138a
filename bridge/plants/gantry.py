"""A simulated robot that hangs from a gantry, in MuJoCo: rope, drives, IMU; no protocol, no ROS, no DDS."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from msgspec import structs
from pydantic.dataclasses import dataclass

from bridge.plants.deviation import Deviation
from bridge.plants.mujoco import MujocoPlant
from bridge.plants.sensors import SensorErrors
from models.config import STRICT, Count, NonNegative, Positive, default_config
from models.constants import GRAVITY
from models.errors import ConfigError
from models.heading import heading
from models.mujoco_model import mujoco_to_pin
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData, Vector, Vector3

STEP = 0.001  #: Period of physics and drives [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class GantryConfig:
    """Schema of ``bridge/config/gantry.yaml``, which has units and meanings."""

    rope_stiffness: Positive
    rope_damping: NonNegative
    rope_drag: NonNegative
    hook: Vector3
    lift: Positive
    lowering_speed: Positive
    listen_samples: Count
    upright_height: Positive
    settle_limit: Positive


class HangingRobot:
    """The robot's side of a protocol. The robot hangs from a rope at its torso; one step is 1 ms.

    The drives execute the last command without a timeout, and have no torque before the first command.

    Args:
        robot: Profile of the simulated robot.
        rate: Rate of the states [Hz].
        seed: Seed of the sensor noise.
        deviation: Differences of the simulated robot from its profile; none when None.
        options: Options of ``MujocoPlant``.
    """

    def __init__(
        self,
        robot: str = "g1",
        *,
        rate: float = 500.0,
        seed: int = 0,
        deviation: Deviation | None = None,
        **options: Any,
    ) -> None:
        self.ticks = round(1.0 / (rate * STEP))  #: Physics steps per state
        if self.ticks < 1 or abs(self.ticks * STEP * rate - 1.0) > 1e-9:
            raise ConfigError(f"rate {rate:g} Hz: a state must take a whole number of steps of {1e3 * STEP:g} ms")
        self.config = default_config(GantryConfig, "bridge", "gantry")
        self.model = RobotModel.load(robot)
        if deviation is not None:
            options["sensor_errors"] = SensorErrors(encoder_offsets=deviation.encoder_offsets(self.model, seed))
        self.plant = MujocoPlant(self.model, seed=seed, timestep=STEP, **options)
        if deviation is not None:
            deviation.apply(self.plant, seed)
        self.tick = 0  #: Physics steps so far [ms]
        self.refused = 0  #: Invalid commands
        self.received = 0  #: Valid commands
        self.command: JointCommand | None = None
        self._specific_forces = np.zeros((self.ticks, 3))  # of the last steps [m/s^2]
        self._torso = self.plant.mujoco.bodies["torso"]
        self.plant.hoist(self.config.lift)
        self.plant.release()
        weight = GRAVITY * float(self.plant.model.body_mass.sum())
        hook = self._hook()
        self._anchor = hook + np.array([0.0, 0.0, 1.0])
        self._length = 1.0 - weight / self.config.rope_stiffness  #: Length of the unloaded rope [m]
        self.rope_speed = 0.0  #: Speed at which the gantry pays out the rope [m/s]
        self.slack = 0.0  #: Rope paid out so far [m]
        self.hooked = True  #: Whether the rope is tied to the robot

    def receive(self, data: bytes) -> None:
        """Handle a command from the network; an invalid one is counted in ``refused``."""
        raise NotImplementedError

    def states(self) -> list[Any]:
        """Messages that the robot sends when a state is ``due``."""
        raise NotImplementedError

    def accept(self, command: JointCommand) -> None:
        """Accept a valid command."""
        self.received += 1
        self.command = command

    def drive(self) -> JointCommand:
        """The command that the drives execute in this step."""
        return JointCommand(*np.zeros((5, self.model.nj))) if self.command is None else self.command

    def step(self) -> None:
        """Advance by 1 ms."""
        self.plant.write(self.drive())
        self._pull()
        self.plant.step()
        self.tick += 1
        self._specific_forces[self.tick % self.ticks] = self.plant.read().accel

    def read(self) -> SensorData:
        """Measurements of a state; the acceleration is the mean since the last state, as of an integrating sensor.

        The value of a single step would have a systematic error, because the commands, and with them the ground
        reaction forces, change at the rate of the states.
        """
        return structs.replace(self.plant.read(), accel=self._specific_forces.mean(axis=0))

    @property
    def due(self) -> bool:
        """Whether a state is due at this tick."""
        return self.tick % self.ticks == 0

    @property
    def imu_quaternion(self) -> Vector:
        """Orientation of the IMU, wxyz (4,)."""
        matrix = self.plant.data.site_xmat[self.plant.mujoco.imu_site].reshape(3, 3)
        return np.roll(pin.Quaternion(matrix).coeffs(), 1)

    @property
    def base(self) -> Vector:
        """True position of the pelvis (3,) [m]."""
        return np.array(self._q[:3])

    @property
    def heading(self) -> float:
        """True heading of the pelvis [rad]."""
        return heading(*self._q[3:7])

    @property
    def _q(self) -> Vector:
        mj, data = self.plant.mujoco, self.plant.data
        return mujoco_to_pin(self.model, mj, data.qpos[mj.qpos], data.qvel[mj.qvel])[0]

    def _hook(self) -> Vector:
        data = self.plant.data
        return np.array(data.xpos[self._torso] + data.xmat[self._torso].reshape(3, 3) @ np.array(self.config.hook))

    def tie(self) -> None:
        """Tie the rope to the robot at its present place, without tension and with the gantry above it."""
        hook = self._hook()
        self._anchor[:2] = hook[:2]
        self.slack, self.hooked = max(float(self._anchor[2] - hook[2]) - self._length, 0.0), True

    def _pull(self) -> None:
        """Apply the force of the rope to the torso."""
        data, body = self.plant.data, self._torso
        self.slack = max(self.slack + self.rope_speed * STEP, 0.0)  # not wound up beyond its start
        if not self.hooked:
            data.xfrc_applied[body] = 0.0
            return
        hook = self._hook()
        along = self._anchor - hook
        distance = float(np.linalg.norm(along))
        along /= distance
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(self.plant.model, data, mujoco.mjtObj.mjOBJ_BODY, body, velocity, 0)
        arm = hook - data.xipos[body]
        speed = velocity[3:] + pin.skew(velocity[:3]) @ (hook - data.xpos[body])
        stretch = distance - self._length - self.slack
        force = np.zeros(3)
        if stretch > 0.0:
            given = self.config
            pull = max(given.rope_stiffness * stretch - given.rope_damping * float(along @ speed), 0.0)
            force = pull * along - given.rope_drag * (speed - along * float(along @ speed))
        data.xfrc_applied[body] = np.concatenate([force, pin.skew(arm) @ force])


class StepLink:
    """Connection to a robot in the same process; commands take effect ``delay`` steps later.

    ``states_pass`` and ``commands_pass`` return the message that arrives for a message sent, None when it is lost.
    """

    def __init__(self, robot: HangingRobot, delay: int = 0) -> None:
        self.robot, self.delay = robot, delay
        self.connected = True
        self.states_pass: Callable[[Any], Any] = lambda message: message
        self.commands_pass: Callable[[bytes], bytes | None] = lambda data: data
        self.sent: list[bytes] = []  #: Commands of the driver
        self.receivers: list[Callable[[bytes], object]] = []  #: Additional subscribers to commands on the driver's side
        self.state_receivers: list[Callable[[Any], object]] = []  #: Additional subscribers to the robot's messages
        self._states: list[Any] = []
        self._on_the_way: list[tuple[int, bytes]] = []
        self._echo: list[bytes] = []
        self._beats: list[bool] = []

    def step(self) -> None:
        """Advance the robot by 1 ms."""
        while self._on_the_way and self._on_the_way[0][0] <= self.robot.tick:
            self.robot.receive(self._on_the_way.pop(0)[1])
        self.robot.step()
        if self.robot.due and self.connected:
            for message in self.robot.states():
                if (passed := self.states_pass(message)) is not None:
                    self._states.append(passed)
                    for receive in self.state_receivers:
                        receive(passed)

    def commands(self) -> list[bytes]:
        """Commands of all programs since the last call."""
        found, self._echo = self._echo, []
        return found

    def beats(self) -> list[bool]:
        """Heartbeats of the guard since the last call: whether it is armed."""
        found, self._beats = self._beats, []
        return found

    def beat(self, armed: bool) -> None:
        """Publish a heartbeat of the guard."""
        self._beats.append(armed)

    def drop(self) -> None:
        """Drop the commands in transit."""
        self._on_the_way.clear()

    def take(self) -> list[Any]:
        """Messages of the robot since the last call."""
        found, self._states = self._states, []
        return found

    def send(self, data: bytes) -> None:
        """Send a command of the driver to the robot."""
        self.sent.append(data)
        self.publish(data)

    def publish(self, data: bytes) -> None:
        """Publish a command of any program on the driver's side."""
        self._echo.append(data)
        for receive in self.receivers:
            receive(data)
        if self.connected and (passed := self.commands_pass(data)) is not None:
            self._on_the_way.append((self.robot.tick + self.delay, passed))

    def close(self) -> None:
        """Disconnect."""
        self.connected = False
