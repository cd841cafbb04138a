"""The simulated robot: a plant in MuJoCo."""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from bridge.plants.base import SimulatedPlant
from bridge.plants.fault_plan import Faults
from bridge.plants.fault_proxy import FaultProxy
from bridge.plants.sensors import SensorErrors, SensorNoise
from bridge.plants.world import ALONE, MujocoWorld
from controllers.joints.joint_servo import drive_torque
from models.errors import CommandError, ConfigError
from models.mujoco_model import mujoco_to_pin
from models.numerics.compiled import njit
from models.numerics.unboxed import Unboxed, unbox
from models.robot_model import RobotModel
from models.scan import Scan
from models.terrain import FLAT, Terrain
from models.types import ContactState, JointCommand, Matrix, RobotState, SensorData, Vector

# Arrays of MuJoCo, and indices of the channels of ``SensorNoise`` in them
_Indices = NDArray[np.int64]
_Channels = tuple[Vector, Vector, Vector, Vector, _Indices, _Indices, _Indices, _Indices]


@njit(cache=True)
def _gather(channels: Unboxed[_Channels], values: Vector) -> None:
    """Copy the channels of ``SensorNoise`` (size,)."""
    qpos, qvel, force, sensordata, joint_qpos, joint_qvel, actuator, sensors = channels.record
    nj, first = len(actuator), len(values) - 12
    for j in range(nj):
        values[j], values[nj + j] = qpos[joint_qpos[j]], qvel[joint_qvel[j]]
        values[2 * nj + j] = force[actuator[j]]
    for i in range(len(sensors)):
        values[3 * nj + i] = sensordata[sensors[i]]
    for i in range(first, len(values)):  # force of foot on sole -> ground on foot, as in foot_wrenches
        values[i] = -values[i]


class MujocoPlant(SimulatedPlant):
    """Robot, sensors, drives and disturbances in a MuJoCo world.

    A tick is ``read``, ``write``, ``step``. Positions, velocities and the angular rate are values at the tick. Wrenches
    and torques are values of the last physics step, the acceleration is the mean over the last tick. The drives
    evaluate a command with the measurements of the tick. In a tick of several physics steps they repeat this before
    each step, with the measurement errors of the tick.

    ``reset`` puts the robot in its 'stand' posture with the soles on the floor. A weld holds its base until
    ``release``. In a world of several robots each has a plant: ``step`` advances one robot, ``step_world`` several.

    ``sensor_noise`` is True for the noise of the profile, False for exact values, or a factor; ``sensor_errors`` and
    ``faults`` add to it. A given ``world``, with a robot of this ``name``, determines friction, payload, terrain,
    timestep and visuals; see ``MujocoWorld`` for these. ``data``, ``ground`` and ``noise`` are for scoring and images
    only; control laws must not read them. Raises ``ConfigError`` for an argument out of range, or a world without this
    robot.
    """

    def __init__(
        self,
        model: RobotModel,
        *,
        seed: int = 0,
        sensor_noise: bool | float = True,
        friction: float | None = None,
        payload_kg: float = 0.0,
        terrain: str | Terrain = FLAT,
        timestep: float = 0.001,
        visuals: bool = False,
        sensor_errors: SensorErrors | None = None,
        faults: Faults | None = None,
        world: MujocoWorld | None = None,
        name: str = ALONE,
    ) -> None:
        self.robot = model
        self.world = world or MujocoWorld(
            {ALONE: model},
            friction=friction,
            payload_kg={ALONE: payload_kg},
            terrain=terrain,
            timestep=timestep,
            visuals=visuals,
        )
        present, self.mujoco = self.world.robot(name)
        if present is not model:
            raise ConfigError(f"world: '{name}' has a model of {present.name}, not the given model of {model.name}")
        self.name = name
        self.model, self.data = self.world.model, self.world.data
        self.ground, self.obstacle = self.world.ground, self.world.obstacle
        self._period = self.world.period
        self.noise = SensorNoise(model, period=self._period, seed=seed, scale=float(sensor_noise), errors=sensor_errors)
        self.faults = FaultProxy(model, period=self._period, seed=seed, plan=faults)
        self._index_channels()
        self._sample: SensorData | None = None
        self._values: Vector | None = None  # channels of the newest sample
        self._command: JointCommand | None = None  # command of this tick
        self._pushes: list[tuple[int, int, Vector]] = []  # end tick (exclusive), body id, force in W (3,) [N]
        self._tick = 0
        # True joint positions [rad] and velocities [rad/s] at the tick, (nj,) each
        self._joints_at_tick: tuple[Vector, Vector] | None = None
        self._specific_forces: list[Vector] = []  # of each physics step of the last tick, (3,) [m/s^2]
        self._held = True
        self._clamped: Vector | None = None  # configuration enforced by a jig, in MuJoCo's order (nq,)
        self.reset()

    def _index_channels(self) -> None:
        """Collect the indices of the channels of ``SensorNoise`` in MuJoCo's arrays; views of these stay valid."""
        mj, data = self.mujoco, self.data
        feet = [mj.sole_force[0], mj.sole_torque[0], mj.sole_force[1], mj.sole_torque[1]]
        sensors = np.concatenate([np.arange(s.start, s.stop) for s in (mj.gyro, mj.accel, *feet)])  # (18,)
        self._joint_qpos, self._joint_qvel = mj.joint_qpos - mj.qpos.start, mj.joint_qvel - mj.qvel.start
        self._qpos, self._qvel = data.qpos[mj.qpos], data.qvel[mj.qvel]  # of the robot
        self._force, self._ctrl = data.actuator_force, data.ctrl
        sources = self._qpos, self._qvel, self._force, data.sensordata
        channels: _Channels = (*sources, self._joint_qpos, self._joint_qvel, mj.actuator, sensors)
        self._channels = unbox(channels)

    @property
    def t(self) -> float:
        return self._tick * self.period

    @property
    def period(self) -> float:
        return self._period

    @property
    def held(self) -> bool:
        return self._held

    def reset(self, seed: int | None = None) -> None:
        self.world.put_back(self.name)
        self._held = True
        self._clamped = None
        self._pushes.clear()
        self._tick = 0
        self.noise.reset(seed)
        self.faults.reset(seed)
        self._sample = self._values = self._command = None
        self._specific_forces.clear()

    def hold(self) -> None:
        self.mujoco.hold(self.data, self._qpos[:3], np.roll(self._qpos[3:7], -1))
        self._held = True

    def release(self) -> None:
        self.mujoco.release(self.data)
        if self._held:
            self.faults.release()
        self._held = False

    def hoist(self, height: float) -> None:
        self._qpos[2] += height
        self.data.mocap_pos[self.mujoco.hold_mocap, 2] += height
        self._sample = None
        mujoco.mj_forward(self.model, self.data)

    def clamp(self, joints: Vector | None) -> None:
        """Clamp joints at true positions (nj,) [rad] in a rigid jig that also holds the base; None opens the jig."""
        self._clamped = None
        if joints is not None:
            self._qpos[self._joint_qpos] = joints
            self._clamped = self._qpos.copy()
            self._qvel[:] = 0.0
            mujoco.mj_forward(self.model, self.data)
        self._sample = None

    def read(self) -> SensorData:
        if self._sample is None:
            values = np.empty(self.noise.size)
            _gather(self._channels, values)
            if self._specific_forces:
                first = 3 * self.robot.nj + 3
                values[first : first + 3] = np.mean(self._specific_forces, axis=0)
            self._sample = self.noise.measure(self.t, values)
            if self.faults.active:
                self.faults.sense(self._tick, values, self._values)
            self._values = values
        return self._sample

    def transmit(self, sensors: SensorData) -> SensorData | None:
        return self.faults.transmit(self._tick, sensors)

    def transmit_scan(self, scan: Scan) -> Scan | None:
        return self.faults.transmit_scan(self._tick, scan) if self.faults.active else scan

    def write(self, command: JointCommand) -> None:
        sensors = self.read()
        self._command = command
        tau = drive_torque(self.robot, command, sensors.q, sensors.v)
        if self.faults.active:
            tau = self.faults.drive(self._tick, tau, self._ctrl[self.mujoco.actuator])
        self._ctrl[self.mujoco.actuator] = tau

    def drive(self) -> None:
        """For the world: update the drives for the next physics step of a tick; a faulty drive keeps its torque."""
        if self._command is None or self._sample is None or self._joints_at_tick is None or self.faults.active:
            return
        q = self._sample.q + (self._qpos[self._joint_qpos] - self._joints_at_tick[0])
        v = self._sample.v + (self._qvel[self._joint_qvel] - self._joints_at_tick[1])
        self._ctrl[self.mujoco.actuator] = drive_torque(self.robot, self._command, q, v)

    def step(self) -> None:
        """Advance this robot by one tick; the other robots of its world stand still."""
        step_world(self.world, (self,))

    def before_step(self) -> None:
        """For the world: prepare the physics of a tick."""
        if self._sample is None:
            self.read()  # the sensor errors depend on the last tick
        self._specific_forces.clear()
        if self.world.substeps > 1:
            self._joints_at_tick = self._qpos[self._joint_qpos], self._qvel[self._joint_qvel]
        if self._pushes:
            self._push()

    def after_substep(self) -> None:
        """For the world: complete a physics step; a jig restores its configuration."""
        if self.world.substeps > 1:
            self._specific_forces.append(self.data.sensordata[self.mujoco.accel].copy())
        if self._clamped is not None:
            self._qpos[:] = self._clamped
            self._qvel[:] = 0.0

    def after_step(self) -> None:
        """For the world: complete a tick."""
        self._tick += 1
        self.noise.advance()
        self._sample = None

    def close(self) -> None:
        self._command = None
        self._ctrl[self.mujoco.actuator] = 0.0

    def push(self, force: tuple[float, float, float] | Vector, duration: float, body: str = "base_link") -> None:
        """Push a body, or the body of a frame, at its CoM from the next step on, in whole ticks; pushes add up."""
        vector = np.asarray(force, dtype=np.float64)
        if vector.shape != (3,) or not np.isfinite(vector).all():
            raise CommandError(f"push: force {force} is not three finite numbers")
        if not 0.0 < duration < np.inf:
            raise CommandError(f"push: duration {duration} s is not positive")
        if body not in self.mujoco.bodies:
            raise CommandError(f"push: unknown body '{body}'; known: {', '.join(sorted(self.mujoco.bodies))}")
        end = self._tick + max(round(duration / self.period), 1)
        self._pushes.append((end, self.mujoco.bodies[body], vector))

    def _push(self) -> None:
        self.data.xfrc_applied[self.mujoco.own_bodies] = 0.0
        self._pushes = [push for push in self._pushes if push[0] > self._tick]
        for _, body, force in self._pushes:
            self.data.xfrc_applied[body, :3] += force

    @property
    def wrenches(self) -> Matrix:
        """True ground reaction wrench on each foot, in its sole frame (2, 6) [N, N.m]."""
        return self.mujoco.foot_wrenches(self.data)

    @property
    def load(self) -> float:
        return float(self.wrenches[:, 2].sum())

    @property
    def com(self) -> Vector:
        """True CoM of robot and payload in W (3,) [m]."""
        return np.array(self.data.subtree_com[self.mujoco.base_body])

    @property
    def truth(self) -> RobotState:
        q, v = mujoco_to_pin(self.robot, self.mujoco, self._qpos, self._qvel)
        left, right = self.wrenches
        return RobotState(
            t=self.t,
            q=q,
            v=v,
            tau=self._force[self.mujoco.actuator],
            contacts=(
                ContactState(active=bool(left[2] > 0.0), wrench=left),
                ContactState(active=bool(right[2] > 0.0), wrench=right),
            ),
        )


def step_world(world: MujocoWorld, plants: Sequence[MujocoPlant]) -> None:
    """Advance robots of a world by one tick; robots not in ``plants`` stand still."""
    data = world.data
    for plant in plants:
        plant.before_step()
    still, kept = [], []
    if len(plants) < len(world.robots):
        still = [mj for mj in world.robots.values() if not any(mj is plant.mujoco for plant in plants)]
        kept = [(data.qpos[mj.qpos].copy(), data.qvel[mj.qvel].copy()) for mj in still]
    for substep in range(world.substeps):
        if substep:
            for plant in plants:
                plant.drive()
        # Step in two halves, so that kinematics and contacts belong to the new configuration on return.
        mujoco.mj_step2(world.model, data)
        for mj, (qpos, qvel) in zip(still, kept, strict=True):
            data.qpos[mj.qpos], data.qvel[mj.qvel] = qpos, qvel
        for plant in plants:
            plant.after_substep()
        mujoco.mj_step1(world.model, data)
    for plant in plants:
        plant.after_step()
