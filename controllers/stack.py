"""The control stack computes joint commands from sensor samples. Simulation, nodes and benchmarks all run it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar

from msgspec import structs

from controllers.balance.controller import BalanceController
from controllers.balance.head import Head, HeadConfig
from controllers.balance.tuning import Tuning
from controllers.estimation.config import EstimatorConfig
from controllers.estimation.estimator import StateEstimator
from controllers.input_log import InputLog
from controllers.safety.health import Health, tilt
from controllers.safety.joint_monitor import JointMonitor
from controllers.safety.preflight import Evidence, preflight
from controllers.safety.supervisor import ACTIVE_MODES, Supervisor
from controllers.whole_body.config import BalanceConfig, WholeBodyConfig
from models.calibration import Calibration, apply_calibration
from models.errors import CommandError, PoiseError
from models.robot_model import RobotModel
from models.status import ControlStatus
from models.types import (
    CommandReply,
    ControlResult,
    JointCommand,
    JointTrajectory,
    Mode,
    Reference,
    RobotState,
    SensorData,
    SolveStatus,
    Vector,
    Velocity,
)
from planners.gait.config import GaitConfig
from planners.gait.footsteps import Foothold
from planners.gait.planner import GaitPlanner
from planners.gait.route import Footstep

if TYPE_CHECKING:
    from planners.motion import MotionPlanner, SizedMotion


T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class StackConfig:
    """Configuration of each stage; None selects the packaged one with the settings of the robot's profile."""

    estimator: EstimatorConfig | None = None
    gait: GaitConfig | None = None
    balance: BalanceConfig | None = None
    whole_body: WholeBodyConfig | None = None
    head: HeadConfig | None = None


class StackSnapshot(NamedTuple):
    """State of the stack between two ticks, without the state of its stages."""

    state: RobotState  #: Last estimate
    scheduled: tuple[bool, bool] | None  #: Whether each foot is in contact in the last reference
    mode: Mode  #: Current mode
    held: Velocity | None  #: Velocity that is applied at every tick; optional
    correction: Calibration | None  #: Calibration in force; optional


class Law(Protocol):
    """Whole-body law of the modes ``stand`` and ``motion``."""

    @property
    def motion_active(self) -> bool:
        """Whether a motion is being executed."""

    @property
    def reference(self) -> Reference:
        """Reference of the last tick."""

    def reset(self, state: RobotState) -> None:
        """Start over from a state."""

    def follow(self, trajectory: JointTrajectory) -> None:
        """Start a motion."""

    def stop_motion(self) -> None:
        """Slow down and hold the posture reached."""

    def step(self, state: RobotState, dt: float) -> ControlResult:
        """One tick."""


class VelocityInput(Protocol):
    """Accepts walking velocities: the stack, or a filter in front of it."""

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Walk with a velocity [m/s, m/s, rad/s]."""

    def stop(self) -> None:
        """Come to a standstill."""


class ControlStack:
    """Calibration, state estimator, supervisor, whole-body law with gait, motions and head, and joint monitor.

        sensors -> calibration -> estimator -> posture or gait -> whole-body QP -> joint command

    The same law runs in all active modes. In the other modes, only the estimator runs; call ``reset`` before the next
    active mode. ``step`` runs all stages of a tick. Nodes construct the stack without ``robot``. They build their
    stages by ``build_estimator``, ``build_gait`` and ``build_law`` with the node's parameters, and run them by
    ``estimate`` and ``control``.

    ``period`` is the time between two ticks [s]; ``law`` replaces ``BalanceController``; ``log`` records the inputs for
    a replay; without ``supervised``, the caller sets the mode by ``enter``.
    """

    def __init__(
        self,
        robot: RobotModel | None = None,
        config: StackConfig | None = None,
        *,
        period: float = 0.001,
        calibration: Calibration | None = None,
        law: Law | None = None,
        log: InputLog | None = None,
        supervised: bool = True,
    ) -> None:
        #: ``calibration`` takes effect at the next ``reset``
        self.log, self.calibration, self._correction = log, calibration, calibration
        self.robot: RobotModel
        self._estimator: StateEstimator | None = None
        self._gait: GaitPlanner | None = None
        self._law: Law | None = None
        self.head: Head | None = None
        self.tuning: Tuning | None = None  #: Changes gains of the standing law at run time
        self._supervisor: Supervisor | None = None
        self.raw: SensorData | None = None  #: Last sample, as measured
        self.sensors: SensorData  #: Last sample, corrected
        self.state: RobotState  #: Last estimate
        self.result: ControlResult  #: Of the last tick in an active mode
        #: Whether each foot is in contact in the last reference; None outside the active modes
        self.scheduled: tuple[bool, bool] | None = None
        self.velocity_input: VelocityInput = self  #: Accepts the velocities of text commands
        self._mode = Mode.OFF
        self._held_velocity: Velocity | None = None
        self._command_t, self._solved = 0.0, SolveStatus.OPTIMAL  # time and status of the last command in this mode
        self._motions: MotionPlanner | None = None
        if robot is not None:
            config = config or StackConfig()
            self.build_gait(robot, config.gait)
            self.build_law(robot, config, period=period, law=law)
            self.build_estimator(robot, config.estimator)
            self._supervisor = Supervisor(robot, gait=True) if supervised else None
            self._description = robot.description

    def build_estimator(self, robot: RobotModel, config: EstimatorConfig | None = None) -> StateEstimator:
        """Build or replace the estimator."""
        self.robot = robot
        self._estimator = StateEstimator(robot, config)
        if self.log is not None:
            self.log.describe("estimator", self.estimator.given)
            self.log.watch("estimator", self.estimator)
        return self.estimator

    def build_gait(self, robot: RobotModel, config: GaitConfig | None = None) -> GaitPlanner:
        """Build or replace the gait planner, which walking requires."""
        self.robot = robot
        self._gait = GaitPlanner(robot, config)
        if self.log is not None:
            self.log.describe("gait", self.gait.config)
        self._connect_gait()
        return self.gait

    def build_law(
        self, robot: RobotModel, config: StackConfig, *, period: float = 0.001, law: Law | None = None
    ) -> None:
        """Build or replace the whole-body law, the head and the joint monitor."""
        self.robot = robot
        if law is None:
            head = None if robot.profile.head is None else Head(robot, config.head)
            law = BalanceController(robot, config.balance, config.whole_body, head=head)
        self._law = law
        self.head, self.tuning = (law.head, Tuning(law)) if isinstance(law, BalanceController) else (None, None)
        self._monitor, self._period = JointMonitor(robot, period), period
        if self.log is not None and isinstance(law, BalanceController):
            self.log.describe("balance", law.config)
            self.log.describe("whole_body", law.whole_body.config)
            if self.head is not None:
                self.log.describe("head", self.head.config)
        self._connect_gait()

    def _connect_gait(self) -> None:
        if isinstance(self._law, BalanceController):
            if self._gait is not None:
                self._law.set_gait(self._gait)
            if self.log is not None:
                self.log.watch("law", (self._law, self.tuning, self._monitor))

    # A tick

    def reset(self, sensors: SensorData, state: RobotState | None = None) -> RobotState:
        """Reset all stages from a sample at rest. With a supervisor in this process, the mode is ``off`` until ``arm``.

        Args:
            sensors: Measured sample, without calibration.
            state: Replaces the estimate; optional.
        """
        estimate = self.reset_estimator(sensors)
        self.state = estimate if state is None else state
        self.switch_off()
        self.reset_law(self.state)
        return self.state

    def switch_off(self) -> None:
        """Enter mode ``off`` and clear all faults."""
        if self._supervisor is not None:
            self._supervisor.reset()
        self._mode = Mode.OFF
        if isinstance(self._law, BalanceController):
            self._law.enter(Mode.OFF)

    def reset_estimator(self, sensors: SensorData, *, after: int | None = None) -> RobotState:
        """Start from a measured sample at rest; ``after`` is the stamp of the previous tick [ns], if there is one."""
        self._correction, self.scheduled = self.calibration, None
        self.raw, self.sensors = sensors, self._correct(sensors)
        if self.log is not None:
            self.log.begin(self.robot.name, sensors, self._correction, steps=after is None, after=after or 0)
            if after is not None:
                self.log.estimated()
        self.state = self.estimator.reset(self.sensors)
        return self.state

    def reset_law(self, state: RobotState) -> None:
        """Start the whole-body law from the state of a standing robot."""
        self.law.reset(state)
        if self.head is not None:
            self.head.discard_command()
        self._monitor.reset()
        self._release_velocity()
        self._record("reset")

    def arm(self) -> CommandReply:
        """Run the preflight checks on the last sample and request mode ``stand``."""
        supervisor = self.supervisor
        evidence = Evidence(self._description, joints=self.sensors.q, base_quaternion=self.state.q[3:7])
        supervisor.set_preflight(preflight(self.robot, supervisor.config, evidence, {}))
        reply = supervisor.request(Mode.STAND)
        self.enter(supervisor.mode)
        return reply

    def step(self, sensors: SensorData, dt: float, state: RobotState | None = None) -> JointCommand | None:
        """Run one tick, ``dt`` [s] after the last; None outside the active modes. ``state`` replaces the estimate."""
        if state is None:
            self.estimate(sensors, dt)
        else:
            self.raw, self.sensors, self.state = sensors, self._correct(sensors), state
        result = self.control(dt)
        return None if result is None else result.command

    def estimate(self, sensors: SensorData, dt: float) -> RobotState:
        """Run calibration and estimator of one tick."""
        self._record_change("dt", dt)
        self.raw, self.sensors = sensors, self._correct(sensors)
        self.state = self.estimator.step(self.sensors, dt, self.scheduled)
        self.scheduled = None
        if self.log is not None:
            self.log.estimated()
        return self.state

    def set_state(self, state: RobotState) -> None:
        """Set the estimate of another process."""
        self.state = state

    def control(self, dt: float) -> ControlResult | None:
        """Run gait, motions, head, whole-body law and joint monitor of one tick; None outside the active modes."""
        self._record_change("mode", self.mode)
        self.scheduled = None
        if self.mode not in ACTIVE_MODES:
            return None
        self._record_change("law_dt", dt)
        state = self.state
        if self.tuning is not None and self.tuning.moving:
            self.tuning.step(dt)
        if self.walking and self._held_velocity is not None:
            self.gait.set_velocity(*self._held_velocity)
        result = self.law.step(state, dt)
        reference = self.reference
        if self.head is not None:
            result = self.head.blend_setpoint(result, reference)
        self._monitor.step(state, result.command)
        if isinstance(self._law, BalanceController):
            self._law.whole_body.set_lookahead(self._monitor.lookahead)
        self.result, self.scheduled = result, reference.contacts
        self._command_t, self._solved = state.t, result.status
        return result

    def supervise(self, t: float, *, drivers_damped: bool = False, hardware: tuple[str, ...] = ()) -> Mode:
        """Update the supervisor at time ``t`` [s] and return the new mode. Call it also when no sample arrives.

        The age of the command counts from the last tick, or from the state at which the active mode began if that is
        later. ``hardware`` are the holds of a real robot's monitors. A hold ends a walk.
        """
        status = self.status
        health = Health(
            state_stamp=self.state.t,
            command_stamp=self._command_t,
            tilt=tilt(self.state.q[3:7]),
            status=status.solve,
            drivers_damped=drivers_damped,
            motion_active=self.motion_active,
            gait_active=self.gait_active,
            joint_fault=status.joint_fault,
            hardware=hardware,
            coasting=0.0 if self._estimator is None else self.estimator.health.coasting,
        )
        mode = self.supervisor.update(health, t)
        self.enter(mode)
        if self.supervisor.take_velocity() is not None:
            self.velocity_input.stop()
        if self.supervisor.take_motion() is not None:
            self.stop_motion()
        return mode

    # Outputs

    @property
    def mode(self) -> Mode:
        """Current mode of the robot."""
        return self._mode if self._supervisor is None else self.supervisor.mode

    @property
    def status(self) -> ControlStatus:
        """Status of the whole-body law and the joint monitor, for the supervisor in this or another process."""
        return ControlStatus(self.mode in ACTIVE_MODES, self._solved, 0, self.joint_fault, self.gait_active)

    @property
    def reference(self) -> Reference:
        """Reference of the last tick."""
        return self.law.reference

    @property
    def posture(self) -> tuple[Vector, Vector]:
        """Start of planned motions: posture (nj,) [rad] and its rate [rad/s], without the motion of the head."""
        reference = self.reference
        if self.head is None:
            return reference.posture, reference.posture_velocity
        return self.head.without_head(reference)

    @property
    def capture_margin(self) -> float:
        """Distance of the DCM from the edge of the support polygon, negative outside [m]; NaN if unknown."""
        margin: float = getattr(self.law, "capture_margin", float("nan"))
        return margin

    @property
    def joint_fault(self) -> str:
        """Fault of a joint; empty without a fault."""
        return self._monitor.fault

    @property
    def delay(self) -> float:
        """Measured delay from a sample to the first later sample that its command affects [s]."""
        return self._monitor.delay

    @property
    def walking(self) -> bool:
        """Whether the gait executes its commands."""
        return isinstance(self._law, BalanceController) and self._law.walking

    @property
    def gait_active(self) -> bool:
        """Whether the robot walks or has not come to a standstill yet."""
        return self.walking and not self.gait.settled

    @property
    def motion_active(self) -> bool:
        """Whether a motion is being executed."""
        return self.law.motion_active

    @property
    def snapshot(self) -> StackSnapshot:
        """State of the stack between two ticks."""
        return StackSnapshot(self.state, self.scheduled, self._mode, self._held_velocity, self._correction)

    def restore(self, snapshot: StackSnapshot) -> None:
        """Restore a snapshot. The caller restores the stages."""
        self.state, self.scheduled, self._mode, self._held_velocity, self._correction = snapshot

    # Inputs, all recorded

    def enter(self, mode: Mode) -> None:
        """Enter a mode."""
        if mode is not self._mode:
            if self._mode not in ACTIVE_MODES and mode in ACTIVE_MODES:
                self._command_t, self._solved = self.state.t, SolveStatus.OPTIMAL
            self._mode = mode
            self._record_change("mode", mode)
        if isinstance(self._law, BalanceController):
            self._law.enter(mode)

    def command(self, text: str) -> CommandReply:
        """Execute a text command (wave, squat, walk, forward, stop, ...), or return the reason for its refusal."""
        supervisor = self.supervisor
        reply = supervisor.text(text)
        self.enter(supervisor.mode)
        velocity, motion = supervisor.take_velocity(), supervisor.take_motion()
        if velocity is not None:
            self.velocity_input.set_velocity(*velocity) if any(velocity) else self.velocity_input.stop()
            reply = _with_note(reply, ", ".join(self.gait.exceeded(velocity).values()))
        if motion == "stop":
            self.stop_motion()
        elif motion is not None:
            try:
                planned = self._plan(motion)
                self.follow(planned.trajectory)
            except PoiseError as error:
                return supervisor.motion_refused(str(error))
            if planned.reduced:
                reply = replace(_with_note(reply, planned.reduced), details={"size": planned.size})
        return reply

    def _plan(self, motion: str) -> "SizedMotion":
        if self._motions is None:
            from planners.motion import MotionPlanner  # imports placo, which is slow

            self._motions = MotionPlanner(self.robot)
        return self._motions.plan_sized(motion, start_q=self.posture[0])

    def follow(self, trajectory: JointTrajectory, number: int | None = None) -> None:
        """Follow a motion; while walking, only with arms and head. Raises as ``BalanceController.follow`` does."""
        trajectory = replace(trajectory, joint_names=self.robot.named(trajectory.joint_names))
        self.law.follow(trajectory)
        if self.head is not None:
            self.head.release(trajectory)
        if self.log is not None:
            number = self.log.number(trajectory) if number is None else number
            self.log.follow(number, trajectory)

    def stop_motion(self) -> None:
        """End the motion; while walking, arms and head return to the posture of the walk."""
        self.law.stop_motion()
        self._record("stop_motion")

    def look(self, pan: float, tilt: float) -> None:
        """Turn the head to joint angles [rad], held until a motion moves the head; ``CommandError`` when refused."""
        if self.head is None:
            raise CommandError("this robot has no movable head: its profile has no 'head.pan' and 'head.tilt'")
        self.head.command(pan, tilt)
        self._record("head", pan, tilt)

    def set_gain(self, name: str, value: float) -> None:
        """Set the target of a gain of the standing law. Raises ``CommandError`` as ``Tuning.set`` does."""
        if self.tuning is None:
            raise CommandError(f"gain '{name}' refused: this whole-body law has no gains to tune")
        self.tuning.set(name, value)
        self._record("gain", name, value)

    def _require_free(self) -> None:
        """Raise ``CommandError`` while the supervisor stops the robot or holds it at a standstill."""
        if self._supervisor is not None and self._supervisor.still:
            why = "; ".join(self._supervisor.holds) or "the robot comes to a standstill"
            raise CommandError(f"walking refused: {why}; command 'walk' afterwards")

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Walk with a velocity [m/s, m/s, rad/s]; see ``GaitPlanner.set_velocity``.

        Raises ``CommandError`` for a nonzero velocity while a supervisor stops the robot or holds it at a standstill.
        """
        if any((forward, left, turn)):
            self._require_free()
        self.gait.set_velocity(forward, left, turn)
        self._record("velocity", forward, left, turn)

    def hold_velocity(self, forward: float, left: float, turn: float) -> None:
        """Apply a velocity [m/s, m/s, rad/s] at every tick, as a joystick does, until ``stop`` or a reset.

        Raises ``CommandError`` as ``set_velocity`` does.
        """
        if any((forward, left, turn)):
            self._require_free()
        self._held_velocity = (forward, left, turn)
        self._record_change("hold_velocity", forward, left, turn)

    def _release_velocity(self) -> None:
        self._held_velocity = None
        if self.log is not None:
            self.log.forget("hold_velocity")

    def stop(self) -> None:
        """Come to a standstill within two steps."""
        self._release_velocity()
        self.gait.stop()
        self._record("stop")

    def walk_to(self, goal: Foothold) -> None:
        """Walk to a pose; see ``GaitPlanner.walk_to``. Refused like a nonzero velocity."""
        self._require_free()
        self.gait.walk_to(goal)
        self._record("walk_to", *structs.astuple(goal))

    def take_steps(self, steps: Sequence[Footstep], after: int | None = None) -> None:
        """Take footsteps; see ``GaitPlanner.take_steps``. Refused like a nonzero velocity."""
        self._require_free()
        self.gait.take_steps(steps, after)
        self._record("take_steps", [step.values for step in steps], after)

    # Stages

    @property
    def estimator(self) -> StateEstimator:
        """State estimator."""
        return _built(self._estimator, "state estimator")

    @property
    def gait(self) -> GaitPlanner:
        """Gait planner."""
        return _built(self._gait, "gait planner")

    @property
    def law(self) -> Law:
        """Whole-body law of the modes ``stand`` and ``motion``."""
        return _built(self._law, "whole-body law")

    @property
    def supervisor(self) -> Supervisor:
        """Supervisor of the modes."""
        return _built(self._supervisor, "supervisor")

    def _correct(self, sensors: SensorData) -> SensorData:
        return sensors if self._correction is None else apply_calibration(sensors, self._correction)

    def _record(self, word: str, *values: object) -> None:
        if self.log is not None:
            self.log.note(word, *values)

    def _record_change(self, word: str, *values: object) -> None:
        if self.log is not None:
            self.log.note_change(word, *values)


def _with_note(reply: CommandReply, note: str) -> CommandReply:
    return replace(reply, reason=f"{reply.reason}; {note}") if note else reply


def _built(stage: T | None, name: str) -> T:
    """Return a stage; ``PoiseError`` when this stack does not have it."""
    if stage is None:
        raise PoiseError(f"this control stack has no {name}: it runs in another process, or has not been configured")
    return stage
