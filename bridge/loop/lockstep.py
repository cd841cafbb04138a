"""One tick of the closed loop: sensors, estimator, supervisor, controller, delay line, drivers, physics, scores."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from bridge.plants.base import hanging_command, release_loaded
from bridge.plants.config import LoopConfig
from bridge.plants.mujoco import MujocoPlant
from controllers.estimation.assembler import mean_sample
from controllers.joints.joint_servo import JointServo, ServoState
from controllers.stack import ControlStack
from models.calibration import correct_encoders, encoder_command
from models.constants import GRAVITY, NANOSECONDS
from models.errors import PoiseError
from models.numerics.compiled import njit
from models.numerics.unboxed import Unboxed, unbox
from models.types import JointCommand, Matrix, Mode, SensorData, SolveStatus, Vector

if TYPE_CHECKING:
    from bridge.loop.recorder import LoopRecorder


class _Feet(NamedTuple):
    """Soles and their slip, for compiled code."""

    positions: Matrix  # of all sites (nsite, 3) [m]
    rotations: Matrix  # of all sites (nsite, 9)
    sites: NDArray[np.int64]  # of the soles (2,)
    radius: Vector  # from the origin of each sole to its farthest corner (2,) [m]
    load: float  # threshold from which a foot stands [N]
    standing: Vector  # 1 where a foot is loaded, else 0 (2,)
    anchor: Matrix  # x, y, yaw of each sole when it last took load (2, 3)
    slip: Vector  # (2,) [m]


@njit(cache=True)
def _measure_slip(wrenches: Matrix, feet: Unboxed[_Feet]) -> None:
    """Update the slip of both feet."""
    positions, rotations, sites, radius, load, standing, anchor, slip = feet.record
    for foot in range(2):
        rotation, position = rotations[sites[foot]], positions[sites[foot]]
        yaw = math.atan2(rotation[3], rotation[0])
        if not wrenches[foot, 2] > load:
            standing[foot] = 0.0
            continue
        if standing[foot] == 0.0:
            standing[foot] = 1.0
            anchor[foot, 0], anchor[foot, 1], anchor[foot, 2] = position[0], position[1], yaw
        turn = abs((yaw - anchor[foot, 2] + math.pi) % (2.0 * math.pi) - math.pi)
        way = math.hypot(position[0] - anchor[foot, 0], position[1] - anchor[foot, 1])
        slip[foot] = max(slip[foot], way + turn * radius[foot])


@njit(cache=True)
def _limb_on_floor(pairs: NDArray[np.int32], is_floor: NDArray[np.bool_], is_limb: NDArray[np.bool_]) -> int:
    """First limb geom in contact with the floor, from pairs of geoms in contact (ncon, 2); -1 if there is none."""
    for k in range(pairs.shape[0]):
        for i in range(2):
            if is_floor[pairs[k, i]] and is_limb[pairs[k, 1 - i]]:
                return int(pairs[k, 1 - i])
    return -1


class PlantMonitor:
    """Detects falls and slip of stance feet.

    The robot counts as fallen, until ``reset``, when the height of the base over the ground is below ``fall_height``
    times the height at ``reset``, the base is tilted more than ``fall_tilt``, or anything but a sole touches the floor.
    The ground is taken under the base, or under a sole if lower: down stairs, the base is over the upper tread.

    Slip of a foot is |p_xy - p_xy,0| + |yaw - yaw_0| r. The pose of the sole when the foot last took load has index 0;
    r is the distance from the origin of the sole to its farthest corner. ``foot_slip`` is the largest slip since
    ``reset`` (2,) [m]; ``reason`` is the kind of fall, empty before a fall.
    """

    def __init__(self, plant: MujocoPlant, config: LoopConfig) -> None:
        self._plant = plant
        self._config = config
        model, mj = plant.model, plant.mujoco
        sites = np.array(mj.sole_sites)
        radius = np.array([np.linalg.norm(foot.corners, axis=1).max() for foot in plant.robot.feet])
        own = model.body_rootid[model.geom_bodyid] == mj.base_body  # (ngeom,)
        is_limb = own & ~np.isin(model.geom_bodyid, model.site_bodyid[sites])
        load = config.slip_load * GRAVITY * plant.robot.mass
        self.foot_slip, self._standing, anchor = np.zeros(2), np.zeros(2), np.zeros((2, 3))
        places, state = (plant.data.site_xpos, plant.data.site_xmat), (self._standing, anchor, self.foot_slip)
        self._feet = unbox(_Feet(*places, sites, radius, load, *state))
        self._grounds = model.geom_bodyid == 0, is_limb  # floor, and what must not touch it (ngeom,)
        self.reset()

    def reset(self) -> None:
        """Clear fall and slip; the present height of the base becomes the standing height."""
        self.fallen = False
        self.reason = ""
        self.foot_slip[:] = self._standing[:] = 0.0
        self._height = self._height_over_ground()

    def update(self) -> None:
        """Evaluate the present state."""
        if not self.fallen:
            self.reason = self._find_fall()
            self.fallen = bool(self.reason)
        _measure_slip(self._plant.wrenches, self._feet)

    def _find_fall(self) -> str:
        data = self._plant.data
        height, least = self._height_over_ground(), self._config.fall_height * self._height
        if not height >= least:
            soles = data.site_xpos[list(self._plant.mujoco.sole_sites)]
            height = max(height, *(self._height_over_ground(x, y) for x, y, _ in soles.tolist()))
        upright = float(data.xmat[self._plant.mujoco.base_body, 8])  # z of W along z of B
        if not height >= least:
            return f"base {height:.2f} m over the ground, {height / self._height:.2f} of its standing height"
        if not upright >= math.cos(self._config.fall_tilt):
            return f"base tilted by {math.degrees(math.acos(max(min(upright, 1.0), -1.0))):.0f} deg"
        limb = _limb_on_floor(data.contact.geom, *self._grounds)
        if limb >= 0:
            body = self._plant.model.geom_bodyid[limb]
            return f"{mujoco.mj_id2name(self._plant.model, mujoco.mjtObj.mjOBJ_BODY, body)} touches the floor"
        return ""

    def _height_over_ground(self, x: float | None = None, y: float | None = None) -> float:
        """Height of the base over the ground at a point of W, by default under the base [m]."""
        base_x, base_y, z = (float(value) for value in self._plant.data.qpos[self._plant.mujoco.qpos][:3])
        return z - self._plant.ground.height(base_x if x is None else x, base_y if y is None else y)


class Lockstep:
    """Advances the laws and the plant together.

    ``control_ticks`` is the number of physics ticks in a tick of the laws, ``delay_ticks`` the number from a
    measurement to its command in the drivers. ``note`` is called with the text of each event, ``after_tick`` at the
    end of every tick, and the optional ``listener`` with every measured sample. ``stamp`` is the time of the tick in
    which the stack received its last sample [ns], ``tick`` counts physics ticks since the controller took over, and
    ``hanging`` is True while only the drivers run.
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
        """Reset, start the stack, and release the base once the feet bear the weight; ``PoiseError`` if that fails."""
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
        """Last part of a tick, after the physics."""
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
        """Run the drivers on corrected encoders; the command to the plant refers to the uncorrected encoders."""
        sensors = correct_encoders(sensors, self._encoder_offsets)
        command = self.servo.step(sensors.t, sensors.q, sensors.v, self.plant.period)
        self.plant.write(encoder_command(command, self._encoder_offsets))
