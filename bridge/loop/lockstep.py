"""One tick of the closed loop: sensors, estimator, supervisor, controller, delay line, drivers, physics, scores."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from bridge.plants.base import hanging_command, release_loaded
from bridge.plants.config import LoopConfig
from bridge.plants.mujoco import MujocoPlant
from controllers.estimation.assembler import mean_sample
from controllers.joints.joint_servo import JointServo, ServoState
from controllers.stack import ControlStack
from models.calibration import correct_encoders, encoder_command
from models.constants import GRAVITY, NANOSECONDS
from models.errors import PoiseError
from models.types import JointCommand, Mode, SensorData, SolveStatus, Vector

if TYPE_CHECKING:
    from bridge.loop.recorder import LoopRecorder


class PlantMonitor:
    """Detects falls and slip of stance feet.

    Fallen, until ``reset``: the base is lower over the ground than ``fall_height`` of its height at ``reset``, or
    tilted more than ``fall_tilt``, or anything but a sole touches the floor.

    Slip of a foot, from the pose of its sole when the foot last took load: |p_xy - p_xy,0| + |yaw - yaw_0| r, with r
    the distance from the sole's origin to the farthest corner. ``foot_slip`` is the largest since ``reset`` (2,) [m];
    ``reason`` is the kind of fall, empty before one.
    """

    def __init__(self, plant: MujocoPlant, config: LoopConfig) -> None:
        self._plant = plant
        self._config = config
        model, mj = plant.model, plant.mujoco
        self._sites = np.array(mj.sole_sites)
        soles = model.site_bodyid[self._sites]
        own = model.body_rootid[model.geom_bodyid] == mj.base_body  # (ngeom,)
        self._is_limb = own & ~np.isin(model.geom_bodyid, soles)
        self._is_floor = model.geom_bodyid == 0
        self._radius = np.array([np.linalg.norm(foot.corners, axis=1).max() for foot in plant.robot.feet])
        self._load = config.slip_load * GRAVITY * plant.robot.mass
        self.reset()

    def reset(self) -> None:
        """Start over; the present height of the base becomes the standing height."""
        self.fallen = False
        self.reason = ""
        self.foot_slip = np.zeros(2)
        self._standing = np.zeros(2, dtype=bool)
        self._anchor = np.zeros((2, 3))  # x, y, yaw
        self._height = self._height_over_ground()

    def update(self) -> None:
        """Evaluate the present state."""
        if not self.fallen:
            self.reason = self._find_fall()
            self.fallen = bool(self.reason)
        self._measure_slip()

    def _find_fall(self) -> str:
        data = self._plant.data
        height = self._height_over_ground()
        upright = float(data.xmat[self._plant.mujoco.base_body, 8])  # z of W along z of B
        if not height >= self._config.fall_height * self._height:
            return f"base {height:.2f} m over the ground, {height / self._height:.2f} of its standing height"
        if not upright >= math.cos(self._config.fall_tilt):
            return f"base tilted by {math.degrees(math.acos(max(min(upright, 1.0), -1.0))):.0f} deg"
        pairs = data.contact.geom  # (ncon, 2)
        forbidden = self._is_floor[pairs].any(axis=1) & self._is_limb[pairs].any(axis=1)
        if forbidden.any():
            pair = pairs[int(np.flatnonzero(forbidden)[0])]
            body = self._plant.model.geom_bodyid[pair[0] if self._is_floor[pair[1]] else pair[1]]
            return f"{mujoco.mj_id2name(self._plant.model, mujoco.mjtObj.mjOBJ_BODY, body)} touches the floor"
        return ""

    def _height_over_ground(self) -> float:
        x, y, z = (float(value) for value in self._plant.data.qpos[self._plant.mujoco.qpos][:3])
        return z - self._plant.ground.height(x, y)

    def _measure_slip(self) -> None:
        data = self._plant.data
        frames = data.site_xmat[self._sites]  # (2, 9)
        now = np.empty((2, 3))
        now[:, :2] = data.site_xpos[self._sites, :2]
        now[:, 2] = np.arctan2(frames[:, 3], frames[:, 0])
        standing = self._plant.wrenches[:, 2] > self._load
        landed = standing & ~self._standing
        self._anchor[landed] = now[landed]
        moved = now - self._anchor
        turn = np.abs((moved[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
        slip = np.hypot(moved[:, 0], moved[:, 1]) + turn * self._radius
        self.foot_slip = np.where(standing, np.maximum(self.foot_slip, slip), self.foot_slip)
        self._standing = standing


class Lockstep:
    """The laws and the plant, advanced together.

    ``control_ticks`` are physics ticks per tick of the laws, ``delay_ticks`` from a measurement to the arrival of its
    command in the drivers. ``note`` takes the text of each event; ``after_tick`` is called at the end of every tick;
    ``listener``, optional, takes every sample as measured. ``stamp`` is that of the tick in which the stack received
    its last sample [ns], ``tick`` counts from when the controller took over, and ``hanging`` is whether only the
    drivers run.
    """

    def __init__(
        self,
        plant: MujocoPlant,
        stack: ControlStack,
        config: LoopConfig,
        *,
        control_ticks: int,
        delay_ticks: int,
        use_truth: bool,
        note: Callable[[str], None],
        after_tick: Callable[[], None],
        recorder: LoopRecorder | None = None,
        drivers: type[JointServo] = JointServo,
    ) -> None:
        self.plant, self.stack, self._config = plant, stack, config
        self._recorder, self._drivers = recorder, drivers
        self.monitor = PlantMonitor(plant, config)
        self.servo = drivers(plant.robot)
        self.tick = self._missed = 0
        self.listener: Callable[[SensorData], None] | None = None
        self.hanging = False
        self.stamp = 0
        self._encoder_offsets: Vector | None = None
        self._control_ticks, self._delay_ticks = control_ticks, delay_ticks
        self._control_dt = control_ticks * plant.period
        self._supervise_ticks = max(round(config.supervise_period / plant.period), 1)
        self._use_truth = use_truth
        self._note, self._after_tick = note, after_tick
        self._hanging_command = hanging_command(plant.robot)
        self._queue: deque[tuple[int, JointCommand]] = deque()

    def start(self, seed: int | None = None) -> None:
        """Reset, start the stack, and release once the feet bear the weight; ``PoiseError`` if that fails."""
        plant, config = self.plant, self._config
        self._reset(seed)
        sensors = self._hang_and_average()
        self.servo.blend()
        self.tick = self._missed = 0
        if self._recorder is not None:
            self._recorder.start()
        self.stack.reset(sensors, plant.truth if self._use_truth else None)
        reply = self.stack.arm()
        if not reply.accepted:
            raise PoiseError(f"{plant.robot.name} cannot stand: {reply.reason}")
        self.monitor.reset()
        release_loaded(plant.robot, plant, config, self.step, self._fault)
        self.monitor.reset()
        self._note("released")

    def _fault(self) -> str:
        """Reason why the robot no longer stands; empty while it does."""
        if self.stack.mode is Mode.STAND:
            return ""
        return "; ".join(self.stack.supervisor.faults) or f"mode '{self.stack.mode.value}'"

    def hang(self, seed: int | None = None) -> None:
        """Reset, and hang the robot from the crane, feet in the air, in its 'stand' posture; mode 'off'."""
        self._reset(seed)
        self.plant.hoist(self._config.hoist_height)
        self.tick = 0
        self.hanging = True
        self._hang_and_average()
        self._note("hanging")

    def _reset(self, seed: int | None) -> None:
        self.plant.reset(seed)
        calibration = self.stack.calibration
        self._encoder_offsets = None if calibration is None else calibration.encoder_offsets
        self.servo = self._drivers(self.plant.robot)
        self.servo.arm()
        self.stack.switch_off()
        self._queue.clear()
        self.hanging = False

    def _hang_and_average(self) -> SensorData:
        samples: list[SensorData] = []
        averaged = max(round(self._config.average_time / self.plant.period), 1)
        for remaining in range(round(self._config.hang_time / self.plant.period), 0, -1):
            sensors = self.plant.read()
            if remaining <= averaged:
                samples.append(sensors)
            self.servo.command(self._hanging_command, sensors.t)
            self._drive(sensors)
            self.plant.step()
        return mean_sample(samples)

    def step(self) -> None:
        """Run one tick."""
        self.before_physics()
        self.plant.step()
        self.after_physics()

    def before_physics(self) -> None:
        """First part of a tick: everything up to the torques."""
        sensors = self.plant.read()
        if self.listener is not None:
            self.listener(sensors)
        if self.hanging:
            self.servo.command(self._hanging_command, sensors.t)
            self._drive(sensors)
            return
        if self.tick % self._control_ticks == 0:
            self._missed += 1
            received = (
                self.plant.transmit(sensors) if self.tick else sensors
            )  # the estimator starts from the first sample
            if received is not None:
                self._control(received, self._missed * self._control_dt)
                self._missed = 0
        if self.tick % self._supervise_ticks == 0:
            self._supervise()
        while self._queue and self._queue[0][0] <= self.tick:
            self.servo.command(self._queue.popleft()[1], sensors.t)
        self._drive(sensors)

    def after_physics(self) -> None:
        """Last part of a tick, once the world has moved."""
        self.tick += 1
        if not self.hanging:
            self._after_tick()

    def _control(self, sensors: SensorData, dt: float) -> None:
        """Run a tick of the stack, ``dt`` [s] after the last sample; the command enters the delay line."""
        stack = self.stack
        self.stamp = round(self.plant.t * NANOSECONDS)
        command = stack.step(sensors, dt, self.plant.truth if self._use_truth else None)
        if stack.log is not None:
            entry = stack.log.take(self.stamp)
            if self._recorder is not None:
                result = None if command is None else stack.result
                self._recorder.tick(self.plant, sensors, stack.state, result, stack.mode, entry)
        if command is not None:
            if stack.result.status is SolveStatus.DAMPED:
                self.servo.damp()
            self._queue.append((self.tick + self._delay_ticks, command))

    def _supervise(self) -> None:
        self.monitor.update()
        before = self.stack.mode
        mode = self.stack.supervise(self.plant.t, drivers_damped=self.servo.state is ServoState.DAMPED)
        if mode is Mode.DAMP and self.servo.state is ServoState.ACTIVE:
            self.servo.damp()
        if mode is not before:
            faults = self.stack.supervisor.faults
            self._note(f"mode {mode.value}" + (f": {'; '.join(faults)}" if faults else ""))

    def _drive(self, sensors: SensorData) -> None:
        """Run the drivers on corrected encoders; the plant receives positions of the uncorrected ones."""
        offsets = self._encoder_offsets
        if offsets is not None:
            sensors = correct_encoders(sensors, offsets)
        command = self.servo.step(sensors.t, sensors.q, sensors.v, self.plant.period)
        self.plant.write(command if offsets is None else encoder_command(command, offsets))
