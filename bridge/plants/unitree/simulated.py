"""A simulated G1 behind the low-level protocol: MuJoCo, drives, IMU, gantry, vendor's controller; no ROS, no DDS.

The robot hangs from a rope at its torso. Until it is released, its vendor's controller damps the joints; after that the
drives execute the last LowCmd for ever, as the real ones are assumed to do, and have no torque before the first.
"""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from bridge.plants.deviation import Deviation
from bridge.plants.mujoco import MujocoPlant
from bridge.plants.sensors import SensorErrors
from bridge.plants.unitree.codec import TICK_WRAP, joint_command
from bridge.plants.unitree.wire import LOW_STATE, read_low_cmd, write_low_state
from models.constants import GRAVITY
from models.errors import MessageError
from models.mujoco_model import mujoco_to_pin
from models.robot_model import RobotModel
from models.types import JointCommand, Vector

STEP = 0.001  #: Physics and drives [s]
ROPE_STIFFNESS, ROPE_DAMPING, ROPE_DRAG = 6000.0, 600.0, 40.0  #: [N/m], [N.s/m], [N.s/m] across the rope
HOOK = (0.0, 0.0, 0.45)  #: Where the rope is tied, in the frame of the torso [m]
LIFT = 0.10  #: Height of the soles above the floor at the start [m]


class GantryRobot:
    """The robot's side, stepped by 1 ms.

    Args:
        robot: Profile of the simulated robot.
        rate: Rate of the states [Hz].
        seed: Of the sensor noise.
        released: Whether the vendor's controller is off from the start.
        deviation: Differences of the simulated robot from its profile; none when None.
        options: Of ``MujocoPlant``.
    """

    def __init__(
        self,
        robot: str = "g1",
        *,
        rate: float = 500.0,
        seed: int = 0,
        released: bool = False,
        deviation: Deviation | None = None,
        **options: Any,
    ) -> None:
        self.model = RobotModel.load(robot)
        if deviation is not None:
            options["sensor_errors"] = SensorErrors(encoder_offsets=deviation.encoder_offsets(self.model, seed))
        self.plant = MujocoPlant(self.model, seed=seed, timestep=STEP, **options)
        if deviation is not None:
            deviation.apply(self.plant, seed)
        self.ticks = round(1.0 / (rate * STEP))  #: Physics steps of a state
        self.tick = 0  #: Physics steps so far [ms]
        self.clock_offset = 0  #: Of the reported tick from ``tick`` [ms]
        self.vendor = "" if released else "ai"
        self.mode_machine = 5
        self.switcher_version = "1.0.0.1"
        self.temperature, self.voltage = np.full(self.model.nj, 40), np.full(self.model.nj, 50.0)
        self.motor_error = np.zeros(self.model.nj, dtype=np.uint32)
        self.remote = bytearray(40)
        self.refused = 0  #: Commands with a wrong checksum or mode_machine
        self.received = 0
        self.command: JointCommand | None = None
        nj = self.model.nj
        zero = np.zeros(nj)
        self._damping = JointCommand(zero, zero, zero, zero, 2.0 * self.model.kd)
        self._torso = self.plant.mujoco.bodies["torso"]
        self.plant.hoist(LIFT)
        self.plant.release()
        weight = GRAVITY * float(self.plant.model.body_mass.sum())
        hook = self._hook()
        self._anchor = hook + np.array([0.0, 0.0, 1.0])
        self._length = 1.0 - weight / ROPE_STIFFNESS  #: Of the rope without load [m]
        self.rope_speed = 0.0  #: At which the gantry lets the rope out [m/s]
        self.slack = 0.0  #: Rope let out so far [m]
        self.hooked = True  #: Whether the rope is tied to the robot
        self._record = np.zeros(1, LOW_STATE)[0]

    def press(self, *buttons: int) -> None:
        """Press the buttons of the remote controller with these bits, and no other."""
        word = sum(1 << bit for bit in buttons)
        self.remote[2:4] = word.to_bytes(2, "little")

    def receive(self, data: bytes) -> None:
        """A LowCmd from the network; ignored with a wrong checksum or type."""
        try:
            record = read_low_cmd(data)
        except MessageError:
            self.refused += 1
            return
        if record["mode_machine"] != self.mode_machine:
            self.refused += 1
            return
        self.accept(joint_command(record, self.model.nj))

    def accept(self, command: JointCommand) -> None:
        """A valid command."""
        self.received += 1
        self.command = command

    def step(self) -> None:
        """Advance by 1 ms."""
        if self.vendor:
            command = self._damping
        else:
            command = JointCommand(*np.zeros((5, self.model.nj))) if self.command is None else self.command
        self.plant.write(command)
        self._pull()
        self.plant.step()
        self.tick += 1

    @property
    def due(self) -> bool:
        """Whether a state is due at this tick."""
        return self.tick % self.ticks == 0

    def state(self) -> bytes:
        """The present LowState, serialised."""
        sensors, record = self.plant.read(), self._record
        motors = record["motor_state"][: self.model.nj]
        motors["mode"] = 1
        motors["q"], motors["dq"], motors["tau_est"] = sensors.q, sensors.v, sensors.tau
        motors["temperature"], motors["vol"] = self.temperature[:, None], self.voltage
        motors["motorstate"] = self.motor_error
        record["quaternion"] = self.imu_quaternion
        record["gyroscope"], record["accelerometer"] = sensors.gyro, sensors.accel
        record["tick"], record["mode_machine"] = (self.tick + self.clock_offset) % TICK_WRAP, self.mode_machine
        record["wireless_remote"] = np.frombuffer(bytes(self.remote), np.uint8)
        return write_low_state(record)

    @property
    def imu_quaternion(self) -> Vector:
        """Orientation of the IMU, wxyz (4,)."""
        matrix = self.plant.data.site_xmat[self.plant.mujoco.imu_site].reshape(3, 3)
        return np.roll(pin.Quaternion(matrix).coeffs(), 1)

    @property
    def base(self) -> Vector:
        """True position of the pelvis (3,) [m]."""
        q, _ = mujoco_to_pin(self.model, self.plant.mujoco, *self._state)
        return np.array(q[:3])

    @property
    def _state(self) -> tuple[Vector, Vector]:
        mj = self.plant.mujoco
        return self.plant.data.qpos[mj.qpos], self.plant.data.qvel[mj.qvel]

    def _hook(self) -> Vector:
        data = self.plant.data
        return np.array(data.xpos[self._torso] + data.xmat[self._torso].reshape(3, 3) @ np.array(HOOK))

    def _pull(self) -> None:
        """Force of the rope on the torso."""
        data, body = self.plant.data, self._torso
        self.slack += self.rope_speed * STEP
        hook = self._hook()
        along = self._anchor - hook
        distance = float(np.linalg.norm(along))
        along /= distance
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(self.plant.model, data, mujoco.mjtObj.mjOBJ_BODY, body, velocity, 0)
        arm = hook - data.xipos[body]
        speed = velocity[3:] + np.cross(velocity[:3], hook - data.xpos[body])
        stretch = distance - self._length - self.slack if self.hooked else 0.0
        force = np.zeros(3)
        if stretch > 0.0:
            pull = max(ROPE_STIFFNESS * stretch - ROPE_DAMPING * float(along @ speed), 0.0)
            force = pull * along - ROPE_DRAG * (speed - along * float(along @ speed))
        data.xfrc_applied[body] = np.concatenate([force, np.cross(arm, force)])


class DirectLink:
    """A robot in the same process, as ``RobotLink`` of the plant; commands take effect ``delay`` steps later.

    ``states_pass`` and ``commands_pass`` return what arrives of a message on the cable, None when it is lost.
    """

    def __init__(self, robot: GantryRobot, delay: int = 0) -> None:
        self.robot, self.delay = robot, delay
        self.connected = True
        self.states_pass: Callable[[bytes], bytes | None] = lambda data: data
        self.commands_pass: Callable[[bytes], bytes | None] = lambda data: data
        self.sent: list[bytes] = []  #: By the driver
        self.receivers: list[Callable[[bytes], object]] = []  #: Further readers of LowCmds at this end of the cable
        self._commands: list[bytes] = []
        self._states: list[bytes] = []
        self._on_the_way: list[tuple[int, bytes]] = []

    def step(self) -> None:
        """Advance the robot by 1 ms."""
        while self._on_the_way and self._on_the_way[0][0] <= self.robot.tick:
            self.robot.receive(self._on_the_way.pop(0)[1])
        self.robot.step()
        if self.robot.due and self.connected and (state := self.states_pass(self.robot.state())) is not None:
            self._states.append(state)

    def drop(self) -> None:
        """Lose the commands that are on the way."""
        self._on_the_way.clear()

    def take(self) -> list[bytes]:
        """States since the last call."""
        found, self._states = self._states, []
        return found

    def send(self, data: bytes) -> None:
        """Send a LowCmd to the robot."""
        self.sent.append(data)
        self.publish(data)

    def publish(self, data: bytes) -> None:
        """A LowCmd of any program at this end of the cable."""
        self._commands.append(data)
        for receive in self.receivers:
            receive(data)
        if self.connected and (passed := self.commands_pass(data)) is not None:
            self._on_the_way.append((self.robot.tick + self.delay, passed))

    def commands(self) -> list[bytes]:
        """LowCmds of all programs since the last call."""
        found, self._commands = self._commands, []
        return found

    def vendor(self) -> str | None:
        """Name of the vendor's active controller; None when the robot does not answer."""
        return self.robot.vendor if self.connected else None

    def version(self) -> str:
        """Version of the motion switcher."""
        return self.robot.switcher_version if self.connected else ""

    def release(self) -> None:
        """End the vendor's controller."""
        if self.connected:
            self.robot.vendor = ""

    def close(self) -> None:
        """Disconnect."""
        self.connected = False
