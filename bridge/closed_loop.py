"""The whole robot in one process, without ROS, in lockstep: for tests, sweeps and notebooks."""

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Literal

import mujoco

from bridge.calibrating import Calibrator
from bridge.loop.ground_view import GroundView
from bridge.loop.lockstep import Lockstep
from bridge.loop.log import LoopBlackBox, LoopLog, make_recorder
from bridge.loop.obstacle_guard import ObstacleGuard
from bridge.plants.config import LoopConfig
from bridge.plants.fault_plan import Faults
from bridge.plants.mujoco import MujocoPlant
from bridge.plants.sensors import SensorErrors
from bridge.plants.world import ALONE, MujocoWorld
from controllers.estimation.config import expecting
from controllers.estimation.estimator import StateEstimator
from controllers.input_log import InputLog
from controllers.joints.joint_servo import JointServo
from controllers.safety.supervisor import ACTIVE_MODES
from controllers.stack import ControlStack, Law, StackConfig
from models.calibration import Calibration
from models.config import default_config
from models.errors import CommandError, ConfigError, PoiseError
from models.robot_model import RobotModel
from models.terrain import FLAT, Terrain
from models.types import CommandReply, ControlResult, Mode, RobotState, Vector
from planners.gait.config import GaitConfig
from planners.gait.planner import GaitPlanner
from planners.terrain.elevation_map import Heights


class ClosedLoop(AbstractContextManager["ClosedLoop"]):
    """Plant, sensors, estimator, supervisor, controller and drivers, tick by tick.

    One tick of length ``timestep``:

        read sensors -> estimator -> supervisor -> controller -> delay line -> joint servo -> physics

    The laws receive ``SensorData`` only. A command computed from the sensors of tick k reaches the drivers in tick
    k + delay_s / timestep (rounded): the delay line models the total latency of measurements and commands. The drivers
    read their encoders without delay.

    At construction and on ``reset``, the base is held with the robot in its 'stand' posture. Meanwhile the sensors are
    averaged, the estimator starts and the controller takes over. The base is released once the feet bear the weight.
    A run therefore starts at about 1 s in mode 'stand'. The same arguments and calls give bit-identical runs.

    Args:
        robot: Name or path of a profile, or a loaded ``RobotModel``.
        seed: Seed of the sensor noise.
        terrain: The ground, or its name in ``models/config/terrain.yaml``.
        friction: Coulomb coefficient of sole on floor [-]; from the profile when None.
        expected_friction: Coefficient that the laws assume at the start [-]; from the profile when None.
        payload_kg: Mass at the torso that the model of the laws does not include [kg].
        sensor_noise: True for the noise of the robot's profile, False for exact sensors, or a factor on the noise.
        delay_s: Latency from a measurement to its command in the drivers [s]; from the profile when None (2 ms).
        timestep: Physics and driver tick [s].
        control_period_s: Tick of estimator and controller [s], a multiple of ``timestep``.
        estimate: 'sensors', or 'truth' to replace the estimator by the true state, for tuning and diagnosis only.
        record: Keep a log.
        record_period_s: Time between two rows of the log [s]; from ``bridge/config/closed_loop.yaml`` when None.
        visuals: Load meshes for pictures.
        controller: Whole-body law to use instead of a new ``BalanceController``.
        stack: Control stack to use instead of a new ``ControlStack`` with ``controller``, ``gait`` and ``calibration``.
        drivers: Joint drivers.
        gait: Settings of the gait; from the robot when None.
        config: Start-up, scoring and log settings; the packaged defaults when None.
        sensor_errors: Sensor errors in addition to those of profile and seed; ``sensor_noise`` does not scale them.
        calibration: Calibration of the sensors; optional.
        faults: Faults of sensors and motors, injected at the release of the base by default; see ``docs/faults.md``.
        obstacle_stop: Whether a walk stops when the scanner of the robot detects ``plant.obstacle`` ahead.
        terrain_map: Whether depth camera and lidar map the ground; ``ground_view.mapper`` holds the map.
        given_map: Ground heights that the map uses where the ground has not been seen.
        start: 'stand', or 'hang' to start hanging from a crane with the feet in the air, for calibrations.
        black_box: Folder of the black box, with one file for each fault that damps the robot; optional.
        mcap: File for a recording that ``poise replay`` reproduces, complete after ``close``; optional. ``reset``
            restarts the recording. Requires the messages of ROS 2.
        world: World shared with other robots, see ``bridge/shared_world.py``; a new one when None.
        name: Name of the robot in that world.

    Raises ``ConfigError`` for an argument out of range, ``RobotModelError`` when the robot cannot be loaded, and
    ``PoiseError`` when the preflight checks fail or the feet of the held robot do not take its weight.
    """

    def __init__(
        self,
        robot: str | Path | RobotModel = "g1",
        seed: int = 0,
        *,
        terrain: str | Terrain = FLAT,
        friction: float | None = None,
        expected_friction: float | None = None,
        payload_kg: float = 0.0,
        sensor_noise: bool | float = True,
        delay_s: float | None = None,
        timestep: float = 0.001,
        control_period_s: float = 0.001,
        estimate: Literal["sensors", "truth"] = "sensors",
        record: bool = True,
        record_period_s: float | None = None,
        visuals: bool = False,
        controller: Law | None = None,
        stack: ControlStack | None = None,
        drivers: type[JointServo] = JointServo,
        gait: GaitConfig | None = None,
        config: LoopConfig | None = None,
        sensor_errors: SensorErrors | None = None,
        calibration: Calibration | None = None,
        faults: Faults | None = None,
        obstacle_stop: bool = False,
        terrain_map: bool = False,
        given_map: Heights | None = None,
        start: Literal["stand", "hang"] = "stand",
        black_box: Path | None = None,
        mcap: Path | None = None,
        world: MujocoWorld | None = None,
        name: str = ALONE,
    ) -> None:
        for option, value, known in (("start", start, ("stand", "hang")), ("estimate", estimate, ("sensors", "truth"))):
            if value not in known:
                raise ConfigError(f"{option}: unknown '{value}'; known: {', '.join(known)}")
        self.config = config or default_config(LoopConfig, "bridge", "closed_loop")
        self.robot = robot if isinstance(robot, RobotModel) else RobotModel.load(robot)
        #: The simulated robot; no law may read it
        self.plant = MujocoPlant(
            self.robot,
            seed=seed,
            sensor_noise=sensor_noise,
            friction=friction,
            payload_kg=payload_kg,
            terrain=terrain,
            timestep=timestep,
            visuals=visuals,
            sensor_errors=sensor_errors,
            faults=faults,
            world=world,
            name=name,
        )
        self.plant.faults.note = self._note
        latency = self.robot.profile.sensors.latency
        delay_ticks = self._ticks("delay_s", latency.sensors + latency.commands if delay_s is None else delay_s)
        control_ticks, tick = self._ticks("control_period_s", control_period_s), self.plant.period
        if control_ticks < 1 or abs(control_ticks * tick - control_period_s) > 1e-3 * tick:
            raise ConfigError(f"control_period_s: {control_period_s} s is not a multiple of the timestep {tick} s")
        period = self.config.record_period if record_period_s is None else record_period_s
        self._record_ticks = max(self._ticks("record_period_s", period), 1) if record else 0
        replayable = estimate == "sensors" and controller is None
        self._recorder = None if mcap is None else make_recorder(self.robot, mcap, replayable=replayable)
        self.stack = stack or ControlStack(
            self.robot,
            StackConfig(estimator=expecting(expected_friction), gait=gait),
            period=control_period_s,
            calibration=calibration,
            law=controller,
            log=InputLog() if replayable and (mcap is not None or black_box is not None) else None,
        )
        if self._recorder is not None and self.stack.log is not None:
            self.stack.log.number = self._recorder.motion
        self._lockstep = Lockstep(
            self.plant,
            self.stack,
            self.config,
            control_ticks=control_ticks,
            delay_ticks=delay_ticks,
            use_truth=estimate == "truth",
            note=self._note,
            after_tick=self._record,
            recorder=self._recorder,
            drivers=drivers,
        )
        self.log = LoopLog(self.robot)
        self.events: list[tuple[float, str]] = []  #: Stamp [s] and text of commands, pushes and changes of mode
        self.black_box = None if black_box is None else LoopBlackBox(self.stack, black_box, self.events)
        self._calibrator = Calibrator(self.robot, self._lockstep)
        self._guard: ObstacleGuard | None = None
        if obstacle_stop:
            self._guard = ObstacleGuard(self._lockstep, seed, float(sensor_noise), self._note)
            self.stack.velocity_input = self._guard
        self._ground_view = None
        if terrain_map or given_map is not None:
            noise = float(sensor_noise)
            self._ground_view = GroundView(self._lockstep, terrain, seed, noise, given_map, sees=terrain_map)
        try:
            (self.hang if start == "hang" else self.reset)()
        except PoiseError:
            if self._recorder is not None:
                self._recorder.discard()
            raise

    def _ticks(self, name: str, time: float) -> int:
        """A time [s] as a number of ticks; ``ConfigError`` when it is negative or not finite."""
        if not 0.0 <= time < float("inf"):
            raise ConfigError(f"{name}: {time} s is negative or not finite")
        return round(time / self.plant.period)

    @property
    def t(self) -> float:
        """Simulated time [s]."""
        return self.plant.t

    @property
    def mode(self) -> Mode:
        """Mode of the supervisor."""
        return self.stack.mode

    @property
    def faults(self) -> tuple[str, ...]:
        """Faults that the supervisor has latched."""
        return self.stack.supervisor.faults

    @property
    def fallen(self) -> bool:
        """Whether the robot has fallen, from the true state; ``fall_reason`` is the kind of fall."""
        return self._lockstep.monitor.fallen

    @property
    def fall_reason(self) -> str:
        """Kind of fall; empty before a fall."""
        return self._lockstep.monitor.reason

    @property
    def foot_slip(self) -> Vector:
        """Largest slip of each stance foot (2,) [m]."""
        return self._lockstep.monitor.foot_slip.copy()

    @property
    def truth(self) -> RobotState:
        """True state of the plant; for scoring only."""
        return self.plant.truth

    @property
    def state(self) -> RobotState:
        """Last estimate."""
        return self.stack.state

    @property
    def result(self) -> ControlResult:
        """Last tick of the controller."""
        return self.stack.result

    @property
    def controller(self) -> Law:
        """The whole-body controller."""
        return self.stack.law

    @property
    def drivers(self) -> JointServo:
        """The joint drivers."""
        return self._lockstep.servo

    @property
    def estimator(self) -> StateEstimator:
        """The state estimator, with its health, the estimated push, and the covariance of ``state``."""
        return self.stack.estimator

    @property
    def gait(self) -> GaitPlanner:
        """The gait planner."""
        return self.stack.gait

    @property
    def ground_view(self) -> GroundView:
        """Range sensors and terrain mapper; ``PoiseError`` without ``terrain_map``."""
        if self._ground_view is None:
            raise PoiseError("ground_view: this loop does not map the ground; create it with terrain_map=True")
        return self._ground_view

    @property
    def model(self) -> mujoco.MjModel:
        """The MuJoCo model."""
        return self.plant.model

    @property
    def data(self) -> mujoco.MjData:
        """The MuJoCo state."""
        return self.plant.data

    def reset(self, seed: int | None = None) -> None:
        """Reset to the state of a new loop; ``seed``, if given, replaces the current seed."""
        self._clear(seed)
        self._lockstep.start(seed)

    def hang(self, seed: int | None = None) -> None:
        """Reset to hanging from a crane, feet in the air, mode 'off', without an estimate; ``reset`` ends it."""
        self._clear(seed)
        self._lockstep.hang(seed)

    def _clear(self, seed: int | None) -> None:
        self.log.clear()
        self.events.clear()
        if self._guard is not None:
            self._guard.reset(seed)
        if self._ground_view is not None:
            self._ground_view.reset(seed)

    @property
    def calibration(self) -> Calibration | None:
        """The calibration that takes effect with the next ``reset`` or ``hang``; settable."""
        return self.stack.calibration

    @calibration.setter
    def calibration(self, calibration: Calibration | None) -> None:
        self.stack.calibration = calibration

    def calibrate(self, what: str) -> CommandReply:
        """Calibrate 'imu', 'joints' or 'feet', with the required motions; takes effect at the next ``reset``."""
        reply = self._calibrator.run(what)
        self._note(f"calibrate {what[:32]}: {reply.reason}")
        return reply

    def run(self, duration: float) -> None:
        """Run for a simulated time [s], rounded to ticks."""
        for _ in range(self._ticks("duration", duration)):
            self.step()

    def command(self, text: str) -> CommandReply:
        """Execute a text command (wave, squat, walk, forward, stop, ...); a refused reply gives the reason."""
        reply = self.stack.command(text)
        self._note(f"{text[:32]}: {reply.reason}")
        return reply

    def wait_motion(self) -> bool:
        """Run until the motion has ended; returns whether the robot stands. ``PoiseError`` after ``motion_limit``."""
        end = self.t + self.config.motion_limit
        while self.mode is Mode.MOTION:
            if self.t > end:
                raise PoiseError(f"motion '{self.stack.supervisor.motion}' did not end in {self.config.motion_limit} s")
            self.step()
        return self.mode is Mode.STAND and not self.fallen

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Walking velocity [m/s, m/s, rad/s], within the gait's limits; ``CommandError`` unless 'walk' and finite."""
        if self.mode is not Mode.WALK:
            raise CommandError(f"velocity refused in mode '{self.mode.value}': command 'walk' first")
        self.stack.velocity_input.set_velocity(forward, left, turn)
        limited = "".join(f"; {text}" for text in self.gait.exceeded((forward, left, turn)).values())
        self._note(f"velocity {forward:g} m/s forward, {left:g} m/s left, {turn:g} rad/s{limited}")

    def look(self, pan: float, tilt: float) -> None:
        """Turn the head to joint angles [rad], clamped to their limits; ``CommandError`` when that is impossible."""
        if self.mode not in ACTIVE_MODES:
            raise CommandError(f"head refused in mode '{self.mode.value}': command 'stand' first")
        self.stack.look(pan, tilt)

    def apply_push(self, force: tuple[float, float, float] | Vector, duration: float, body: str = "base_link") -> None:
        """Push a body at its centre of mass by a force in the world (3,) [N]; ``CommandError`` when invalid."""
        self.plant.push(force, duration, body)
        self._note(f"push ({force[0]:g}, {force[1]:g}, {force[2]:g}) N for {duration:g} s on {body}")

    def inject(self, faults: Faults) -> str:
        """Inject faults, timed from the next tick; returns a description. Invalid ones raise ``ConfigError``."""
        return self.plant.faults.inject(faults)

    def clear_faults(self) -> str:
        """End every injected fault; returns their description. Faults that the supervisor has latched remain."""
        return self.plant.faults.clear()

    def close(self) -> None:
        """Complete the recording, if any; nothing more is written to it."""
        if self._recorder is not None:
            self._recorder.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def step(self) -> None:
        """Run one tick."""
        self.before_physics()
        self.plant.step()
        self.after_physics()

    def before_physics(self) -> None:
        """First part of a tick: laws and drivers. ``SharedWorld`` then advances the physics of several robots."""
        self._lockstep.before_physics()

    def after_physics(self) -> None:
        """Last part of a tick, after the physics."""
        self._lockstep.after_physics()
        if self._guard is not None:
            self._guard.step()
        if self._ground_view is not None:
            self._ground_view.step()

    def _record(self) -> None:
        lockstep = self._lockstep
        if self.black_box is not None:
            self.black_box.tick(lockstep)
        if self._record_ticks and lockstep.tick % self._record_ticks == 0:
            self._add_row()

    def _add_row(self) -> None:
        self.log.add(self.plant.truth, self.plant.com, self.state, self.result, self.mode, self.gait)

    def _note(self, text: str) -> None:
        self.events.append((self.t, text))
        if self._recorder is not None:
            self._recorder.event(text)
