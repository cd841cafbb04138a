"""The whole robot in one process, without ROS, in lockstep: for tests, sweeps and notebooks."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Literal, Protocol

import mujoco

from bridge.loop_config import LoopConfig
from bridge.loop_log import LoopLog
from bridge.monitor import PlantMonitor
from bridge.mujoco_plant import MujocoPlant
from bridge.start_up import ReleaseGate, average, hanging_command
from controllers.balance import BalanceController
from controllers.estimation.estimator import StateEstimator
from controllers.health import Health, tilt
from controllers.joint_servo import JointServo, ServoState
from controllers.supervisor import ACTIVE_MODES, Supervisor
from models.config import default_config
from models.errors import CommandError, ConfigError, PoiseError
from models.robot_model import RobotModel
from models.types import (
    CommandReply,
    ControlResult,
    JointCommand,
    JointTrajectory,
    Mode,
    RobotState,
    SensorData,
    SolveStatus,
    Vector,
)
from planners.motion import MotionPlanner


class Controller(Protocol):
    """What the loop needs of a whole-body controller."""

    @property
    def motion_active(self) -> bool:
        """Whether a motion is being executed."""
        ...

    def reset(self, state: RobotState) -> None:
        """Start over from a state."""
        ...

    def follow(self, trajectory: JointTrajectory) -> None:
        """Start a motion."""
        ...

    def stop_motion(self) -> None:
        """Hold the posture that the motion has reached."""
        ...

    def step(self, state: RobotState, dt: float) -> ControlResult:
        """One tick."""
        ...


class ClosedLoop:
    """Plant, sensors, estimator, supervisor, controller and drivers, tick by tick.

    One tick of length ``timestep``:

        read sensors -> estimator -> supervisor -> controller -> delay line -> joint servo -> physics

    The laws get ``SensorData`` and nothing else of the plant. A command computed from the sensors of tick k reaches the
    drivers in tick k + delay_s / timestep (rounded): the one delay line stands for the way of the measurements to the
    computer and of the commands back. The drivers themselves read their encoders without delay.

    When built and on ``reset``, the robot is held at its base in its 'stand' posture while the sensors are averaged,
    the estimator starts and the controller takes over; it is let go once its feet carry its weight. So time starts at
    about one second, in mode 'stand'. The same arguments and calls give bit-identical runs.

    Args:
        robot: Name or path of a profile, or a loaded ``RobotModel``.
        seed: Of the sensor noise.
        terrain: Floor, one of ``models.mujoco_model.TERRAINS``.
        friction: Coulomb coefficient of sole on floor [-]; the profile's when None.
        payload_kg: Mass at the torso that no law knows of [kg].
        sensor_noise: True for the noise of the robot's profile, False for exact sensors, or a factor on the noise.
        delay_s: From measurement to the arrival of its command in the drivers [s]; the profile's when None (2 ms).
        timestep: Physics and driver tick [s].
        control_period_s: Tick of estimator and controller [s], a multiple of ``timestep``.
        estimate: 'sensors', or 'truth' to replace the estimator by the true state: for tuning and for telling whose
            fault it is, never for a figure.
        record: Keep a log.
        record_period_s: Time between two rows of it [s]; that of ``bridge/config/closed_loop.yaml`` when None.
        visuals: Load meshes for pictures.
        controller: Whole-body controller to use instead of a new ``BalanceController``.
        config: Start-up, scoring and log settings; the packaged ones when None.

    Attributes:
        robot: The robot.
        plant: The simulated robot; no law may see it.
        log: What was recorded.
        events: Stamp [s] and text of commands, pushes and changes of mode.
        result: Last tick of the controller.
        state: Last estimate.

    Raises:
        ConfigError: An argument is out of range.
        RobotModelError: The robot cannot be loaded.
        PoiseError: The feet of the held robot did not take its weight.
    """

    def __init__(
        self,
        robot: str | Path | RobotModel = "g1",
        seed: int = 0,
        *,
        terrain: str = "flat",
        friction: float | None = None,
        payload_kg: float = 0.0,
        sensor_noise: bool | float = True,
        delay_s: float | None = None,
        timestep: float = 0.001,
        control_period_s: float = 0.001,
        estimate: Literal["sensors", "truth"] = "sensors",
        record: bool = True,
        record_period_s: float | None = None,
        visuals: bool = False,
        controller: Controller | None = None,
        config: LoopConfig | None = None,
    ) -> None:
        if estimate not in ("sensors", "truth"):
            raise ConfigError(f"estimate: unknown '{estimate}'; known: sensors, truth")
        self.config = config or default_config(LoopConfig, "bridge", "closed_loop")
        self.robot = robot if isinstance(robot, RobotModel) else RobotModel.load(robot)
        self.plant = MujocoPlant(
            self.robot,
            seed=seed,
            sensor_noise=sensor_noise,
            friction=friction,
            payload_kg=payload_kg,
            terrain=terrain,
            timestep=timestep,
            visuals=visuals,
        )
        latency = self.robot.profile.sensors.latency
        self._delay = self._ticks("delay_s", latency.sensors + latency.commands if delay_s is None else delay_s)
        self._control_ticks = self._ticks("control_period_s", control_period_s)
        if self._control_ticks < 1 or abs(self._control_ticks * timestep - control_period_s) > 1e-3 * timestep:
            raise ConfigError(f"control_period_s: {control_period_s} s is not a multiple of the timestep {timestep} s")
        period = self.config.record_period if record_period_s is None else record_period_s
        self._record_ticks = max(self._ticks("record_period_s", period), 1) if record else 0
        self._supervise_ticks = max(self._ticks("supervise_period", self.config.supervise_period), 1)
        self._control_dt = self._control_ticks * timestep
        self._use_truth = estimate == "truth"
        self._estimator = StateEstimator(self.robot)
        self._controller: Controller = BalanceController(self.robot) if controller is None else controller
        self._supervisor = Supervisor(self.robot)
        self._planner: MotionPlanner | None = None
        self._monitor = PlantMonitor(self.plant, self.config)
        self._hang = hanging_command(self.robot)
        self._queue: deque[tuple[int, JointCommand]] = deque()
        self.log = LoopLog(self.robot)
        self.events: list[tuple[float, str]] = []
        self.reset()

    def _ticks(self, name: str, time: float) -> int:
        """A time [s] as a number of ticks; ``ConfigError`` when it is negative or not finite."""
        if not 0.0 <= time < float("inf"):
            raise ConfigError(f"{name}: {time} s is not a time")
        return round(time / self.plant.period)

    @property
    def t(self) -> float:
        """Simulated time [s]."""
        return self.plant.t

    @property
    def mode(self) -> Mode:
        """What the supervisor has the robot do."""
        return self._supervisor.mode

    @property
    def faults(self) -> tuple[str, ...]:
        """Faults that the supervisor has latched."""
        return self._supervisor.faults

    @property
    def fallen(self) -> bool:
        """Whether the robot has fallen, by the true state; ``fall_reason`` says how."""
        return self._monitor.fallen

    @property
    def fall_reason(self) -> str:
        """How it fell; empty while it has not."""
        return self._monitor.reason

    @property
    def foot_slip(self) -> Vector:
        """Largest slide of each foot on the floor while it stood (2,) [m]."""
        return self._monitor.foot_slip

    @property
    def truth(self) -> RobotState:
        """True state of the plant; for scoring only."""
        return self.plant.truth

    @property
    def controller(self) -> Controller:
        """The whole-body controller."""
        return self._controller

    @property
    def model(self) -> mujoco.MjModel:
        """The MuJoCo model."""
        return self.plant.model

    @property
    def data(self) -> mujoco.MjData:
        """The MuJoCo state."""
        return self.plant.data

    def reset(self, seed: int | None = None) -> None:
        """Start over, as a new loop would; a seed replaces the present one."""
        self.plant.reset(seed)
        self._servo = JointServo(self.robot)
        self._supervisor.reset()
        self._supervisor.set_preflight(())
        self._queue.clear()
        self.log.clear()
        self.events.clear()
        self._tick = 0
        self._command_t = 0.0
        self._start()

    def run(self, duration: float) -> None:
        """Run for a simulated time [s], rounded to ticks."""
        for _ in range(self._ticks("duration", duration)):
            self.step()

    def command(self, text: str) -> CommandReply:
        """Carry out a text command (wave, squat, stop, ...), or say why not."""
        reply = self._supervisor.text(text)
        motion = self._supervisor.take_motion()
        if motion == "stop":
            self._controller.stop_motion()
        elif motion is not None:
            reply = self._begin(motion, reply)
        self._note(f"{text[:32]}: {reply.reason}")
        return reply

    def _begin(self, motion: str, reply: CommandReply) -> CommandReply:
        """Plan a motion from the estimated posture and have the controller follow it."""
        self._planner = self._planner or MotionPlanner(self.robot)
        reference = getattr(self._controller, "reference", None)
        start = self.state.q[7:] if reference is None else reference.posture
        try:
            self._controller.follow(self._planner.plan(motion, start_q=start))
        except PoiseError as error:
            return self._supervisor.motion_refused(str(error))
        return reply

    def wait_motion(self) -> bool:
        """Run until the motion has ended; returns whether the robot still stands.

        Raises:
            PoiseError: It did not end within ``motion_limit``.
        """
        end = self.t + self.config.motion_limit
        while self.mode is Mode.MOTION:
            if self.t > end:
                raise PoiseError(f"motion '{self._supervisor.motion}' did not end in {self.config.motion_limit} s")
            self.step()
        return self.mode is Mode.STAND and not self.fallen

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Walking velocity [m/s, m/s, rad/s]; always refused: there is no gait planner.

        Raises:
            CommandError: Always.
        """
        raise CommandError(f"velocity ({forward}, {left}, {turn}) refused: no gait planner is configured")

    def apply_push(self, force: tuple[float, float, float] | Vector, duration: float, body: str = "base_link") -> None:
        """Push a body at its centre of mass with a force in the world (3,) [N] for a time [s], from the next tick on.

        Raises:
            CommandError: The body is unknown, or force or duration is not usable.
        """
        self.plant.apply_push(force, duration, body)
        self._note(f"push ({force[0]:g}, {force[1]:g}, {force[2]:g}) N for {duration:g} s on {body}")

    def step(self) -> None:
        """Run one tick."""
        sensors = self.plant.read()
        if self._tick % self._control_ticks == 0:
            self._control(sensors)
        if self._tick % self._supervise_ticks == 0:
            self._supervise()
        while self._queue and self._queue[0][0] <= self._tick:
            self._servo.command(self._queue.popleft()[1], sensors.t)
        self._drive(sensors)
        if self._record_ticks and self._tick % self._record_ticks == 0:
            self.log.add(self.plant.truth, self.plant.com, self.state, self.result, self.mode)

    def _control(self, sensors: SensorData) -> None:
        """Estimator and controller; the command enters the delay line."""
        self.state = self.plant.truth if self._use_truth else self._estimator.step(sensors, self._control_dt)
        if self._supervisor.mode not in ACTIVE_MODES:
            return
        self.result = self._controller.step(self.state, self._control_dt)
        self._command_t = sensors.t
        if self.result.status is SolveStatus.DAMPED:
            self._servo.damp()
        self._queue.append((self._tick + self._delay, self.result.command))

    def _supervise(self) -> None:
        """Supervisor, scores, and what a mode means for the drivers."""
        self._monitor.update()
        before = self._supervisor.mode
        health = Health(
            state_stamp=self.state.t,
            command_stamp=self._command_t,
            tilt=tilt(self.state.q[3:7]),
            status=self.result.status,
            drivers_damped=self._servo.state is ServoState.DAMPED,
            motion_active=self._controller.motion_active,
        )
        mode = self._supervisor.update(health, self.t)
        if mode is Mode.DAMP and self._servo.state is ServoState.ACTIVE:
            self._servo.damp()
            self._controller.stop_motion()
        if mode is not before:
            self._note(f"mode {mode.value}" + (f": {'; '.join(self.faults)}" if self.faults else ""))

    def _drive(self, sensors: SensorData) -> None:
        """Drivers and physics."""
        self.plant.write(self._servo.step(sensors.t, sensors.q, sensors.v, self.plant.period))
        self.plant.step()
        self._tick += 1

    def _note(self, text: str) -> None:
        self.events.append((self.t, text))

    def _start(self) -> None:
        """Hang, average, hand over to the controller, and let go when the feet carry the robot."""
        self._servo.arm()
        samples: list[SensorData] = []
        keep = self._ticks("average_time", self.config.average_time)
        for left in range(self._ticks("hang_time", self.config.hang_time), 0, -1):
            sensors = self.plant.read()
            if left <= keep:
                samples.append(sensors)
            self._servo.command(self._hang, sensors.t)
            self._drive(sensors)
        state = self._estimator.reset(average(samples))
        self._tick = 0  # of the control loop: it starts with a controller tick
        self.state = self.plant.truth if self._use_truth else state
        self._controller.reset(self.state)
        self._supervisor.request(Mode.STAND)
        gate = ReleaseGate(self.robot, self.config)
        self._control(self.plant.read())
        self._monitor.reset()
        self._command_t = self.t
        while not gate.update(self.plant.read(), self.plant.period):
            if gate.waited > self.config.settle_limit or self.mode is not Mode.STAND:
                why = "; ".join(self.faults) or f"the feet carry {gate.load:.0f} N of {gate.weight:.0f} N"
                raise PoiseError(f"{self.robot.name} cannot be let go after {gate.waited:.1f} s: {why}")
            self.step()
        self.plant.hold(False)
        self._monitor.reset()
        self._note("released")
