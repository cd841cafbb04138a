"""One tick of everything: sensors, estimator, supervisor, controller, delay line, drivers, physics."""

from __future__ import annotations

import zlib
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from bridge.loop_config import LoopConfig
from bridge.monitor import PlantMonitor
from bridge.mujoco_plant import MujocoPlant
from bridge.start_up import ReleaseGate, hanging_command
from controllers.balance import BalanceController
from controllers.estimation.estimator import StateEstimator
from controllers.health import Health, tilt
from controllers.joint_monitor import JointMonitor
from controllers.joint_servo import JointServo, ServoState
from controllers.law_switch import LawSwitch
from controllers.preflight import Evidence, preflight
from controllers.sample_assembler import mean_sample
from controllers.supervisor import ACTIVE_MODES, Supervisor
from controllers.walker import Walker
from controllers.walking import WalkingController
from models.applied import Applied
from models.calibration import Calibration, apply_calibration
from models.constants import NANOSECONDS
from models.errors import PoiseError
from models.types import (
    ControlResult,
    JointCommand,
    JointTrajectory,
    Mode,
    Reference,
    RobotState,
    SensorData,
    SolveStatus,
)
from planners.gait.config import GaitConfig
from planners.gait.gait import GaitPlanner
from planners.gait.noted import NotedGait

if TYPE_CHECKING:
    from bridge.loop_recorder import LoopRecorder


class Controller(Protocol):
    """What the loop needs of a whole-body controller."""

    @property
    def motion_active(self) -> bool:
        """Whether a motion is being executed."""
        ...

    @property
    def reference(self) -> Reference:
        """What the last tick tracked."""
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


class Lockstep:
    """The laws and the plant, advanced together.

    Args:
        plant: Simulated robot; the laws get its ``SensorData`` only.
        controller: Whole-body controller.
        config: Start-up and supervision.
        control_ticks: Physics ticks to a tick of estimator and controller.
        delay_ticks: Physics ticks from a measurement to the arrival of its command in the drivers.
        use_truth: Whether the true state replaces the estimate.
        note: Takes a sentence about what happened.
        after_tick: Called at the end of every tick.
        calibration: Corrects the sensors from the next ``start`` on; None for none.
        gait: The gait; that of the robot when None.
        applied: Notes what the laws are told, for a replay; None for nobody.
        recorder: Writes what the laws get and give into a file; None for nobody. Needs ``applied``.

    Attributes:
        plant: The simulated robot.
        controller: The whole-body controller.
        laws: Which of it and the walker moves the joints.
        supervisor: Mode machine.
        estimator: The state estimator.
        monitor: Fall and slip of the true robot.
        servo: Drivers.
        sensors: Last sample, as it was measured.
        heard: Last sample, as the laws got it.
        stamp: Of the tick with which they got it [ns].
        state: Last estimate.
        result: Last tick of the controller.
        tick: Ticks since the controller took over.
        calibration: Corrects the sensors from the next ``start`` on; None for none.
        listener: Gets every sample as measured, uncorrected; None for nobody.
        hanging: Whether the robot hangs from the crane and only its drivers run.
    """

    def __init__(
        self,
        plant: MujocoPlant,
        controller: Controller,
        config: LoopConfig,
        *,
        control_ticks: int,
        delay_ticks: int,
        use_truth: bool,
        note: Callable[[str], None],
        after_tick: Callable[[], None],
        calibration: Calibration | None = None,
        gait: GaitConfig | None = None,
        applied: Applied | None = None,
        recorder: LoopRecorder | None = None,
    ) -> None:
        self.plant, self.controller, self._config = plant, controller, config
        self._notes, self._recorder = applied, recorder
        self.supervisor = Supervisor(plant.robot, gait=True)
        self.monitor = PlantMonitor(plant, config)
        self.servo = JointServo(plant.robot)
        self.tick = self._unheard = 0
        self.calibration, self._applied = calibration, calibration
        self.listener: Callable[[SensorData], None] | None = None
        self.hanging = False
        self.sensors: SensorData
        self.heard: SensorData | None = None
        self.stamp = 0
        self.state: RobotState
        self.result: ControlResult
        self._gait = gait
        self._walker: Walker[GaitPlanner] | None = None
        monitor = JointMonitor(plant.robot, control_ticks * plant.period)
        self._head = controller.head if isinstance(controller, BalanceController) else None
        self.laws = LawSwitch(controller, lambda: self.walker, monitor, applied, self._head)
        self.estimator = StateEstimator(plant.robot)
        self._control_ticks, self._delay_ticks = control_ticks, delay_ticks
        self._control_dt = control_ticks * plant.period
        self._supervise_ticks = max(round(config.supervise_period / plant.period), 1)
        self._use_truth = use_truth
        self._note, self._after_tick = note, after_tick
        self._description = plant.robot.urdf.read_text(encoding="utf-8")
        self._hang = hanging_command(plant.robot)
        self._queue: deque[tuple[int, JointCommand]] = deque()
        self._command_t = 0.0
        self._scheduled: tuple[bool, bool] | None = None

    def start(self, seed: int | None = None) -> None:
        """Reset everything; hang, average, hand over to the controller, and let go when the feet carry the robot.

        Raises:
            PoiseError: The preflight checks fail, the feet do not take the weight within ``settle_limit``, or a fault
                comes first.
        """
        plant, config = self.plant, self._config
        self._rewind(seed)
        sensors = self._hang_and_average()
        self.servo.blend()
        state = self.estimator.reset(sensors)
        self.tick = self._unheard = 0
        self._scheduled = None
        self.state = plant.truth if self._use_truth else state
        if self._recorder is not None:
            self._recorder.start()
        if self._notes is not None:
            self._notes.begin(plant.robot.name, sensors, steps=True)
        self.laws.reset(self.state)
        evidence = Evidence(self._description, joints=sensors.q, base_quaternion=self.state.q[3:7])
        self.supervisor.set_preflight(preflight(plant.robot, self.supervisor.config, evidence, {}))
        reply = self.supervisor.request(Mode.STAND)
        if not reply.accepted:
            raise PoiseError(f"{plant.robot.name} cannot stand: {reply.reason}")
        self.monitor.reset()
        gate = ReleaseGate(plant.robot, config)
        while not gate.update(plant.load, plant.period):
            if gate.waited > config.settle_limit or self.supervisor.mode is not Mode.STAND:
                why = "; ".join(self.supervisor.faults) or f"the feet carry {gate.load:.0f} N of {gate.weight:.0f} N"
                raise PoiseError(f"{plant.robot.name} cannot be let go after {gate.waited:.1f} s: {why}")
            self.step()
        plant.hold(False)
        self.monitor.reset()
        self._note("released")

    def hang(self, seed: int | None = None) -> None:
        """Reset everything and hang the robot from the crane, feet in the air, in its 'stand' posture; mode off."""
        self._rewind(seed)
        self.plant.hoist(self._config.hoist_height)
        self.tick = 0
        self.hanging = True
        self._hang_and_average()
        self._note("hanging")

    def _rewind(self, seed: int | None) -> None:
        """Plant, drivers and supervisor as new; a new calibration takes effect."""
        self.plant.reset(seed)
        self._applied = self.calibration
        self.servo = JointServo(self.plant.robot)
        self.servo.arm()
        self.supervisor.reset()
        self._queue.clear()
        self.hanging = False

    def _sense(self) -> SensorData:
        """This tick's sample, corrected by the calibration."""
        raw = self.plant.read()
        return raw if self._applied is None else apply_calibration(raw, self._applied)

    @property
    def walker(self) -> Walker[GaitPlanner]:
        """Gait planner and walking controller; built when first asked for."""
        if self._walker is None:
            robot, notes = self.plant.robot, self._notes
            gait = GaitPlanner(robot, self._gait) if notes is None else NotedGait(robot, self._gait, notes)
            self._walker = Walker(gait, WalkingController(robot), head=self._head)
        return self._walker

    def follow(self, trajectory: JointTrajectory) -> None:
        """Have the law in charge follow a motion; see ``BalanceController.follow`` for refusals."""
        self.laws.follow(trajectory)
        if self._notes is not None:
            unrecorded = zlib.crc32(trajectory.positions.tobytes())
            number = unrecorded if self._recorder is None else self._recorder.motion(trajectory)
            self._notes.follow(number, trajectory, trajectory.times.tolist())

    def enter_mode(self) -> None:
        """Hand the robot over between balance controller and walker after a change of mode."""
        self.laws.enter(self.supervisor.mode, self.state)

    def _hang_and_average(self) -> SensorData:
        """Hang under gravity compensation; returns the mean of the last sensor samples."""
        samples: list[SensorData] = []
        keep = max(round(self._config.average_time / self.plant.period), 1)
        for left in range(round(self._config.hang_time / self.plant.period), 0, -1):
            sensors = self._sense()
            if left <= keep:
                samples.append(sensors)
            self.servo.command(self._hang, sensors.t)
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
        self.sensors = sensors = self._sense()
        if self.listener is not None:
            self.listener(self.plant.read())
        if self.hanging:
            self.servo.command(self._hang, sensors.t)
            self._drive(sensors)
            return
        if self.tick % self._control_ticks == 0:
            self._unheard += 1
            heard = self.plant.heard(sensors) if self.tick else sensors  # the estimator has started from the first one
            if heard is not None:
                self._control(heard, self._unheard * self._control_dt)
                self._unheard = 0
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
        """Estimator and controller, a time [s] after the last sample; the command enters the delay line."""
        if self._use_truth:
            self.state = self.plant.truth
        else:
            self.state = self.estimator.step(sensors, dt, self._scheduled)
        self._scheduled = None
        self.heard, self.stamp = sensors, round(self.plant.t * NANOSECONDS)
        if self.supervisor.mode not in ACTIVE_MODES:
            self._tell(sensors, dt, None)
            return
        self.result = self.laws.step(self.state, dt)
        self._tell(sensors, dt, self.result)
        self._scheduled = self.laws.reference.contacts
        self._command_t = self.state.t
        if self.result.status is SolveStatus.DAMPED:
            self.servo.damp()
        self._queue.append((self.tick + self._delay_ticks, self.result.command))

    def _tell(self, sensors: SensorData, dt: float, result: ControlResult | None) -> None:
        """End of a tick: note how long it was [s] and whether a law answered it; have it recorded."""
        if self._notes is None:
            return
        for word, value in (("dt", dt), ("law_dt", dt), ("run", result is not None)):
            self._notes.note_change(word, value)
        note = self._notes.take(self.stamp)
        if self._recorder is not None:
            self._recorder.tick(self.plant, sensors, self.state, result, self.supervisor.mode, note)

    @property
    def scheduled(self) -> tuple[bool, bool] | None:
        """Feet that the last reference has in contact; None where no law moved the joints."""
        return self._scheduled

    def _supervise(self) -> None:
        """Supervisor, scores, and what a mode means for the drivers."""
        self.monitor.update()
        before = self.supervisor.mode
        health = Health(
            state_stamp=self.state.t,
            command_stamp=self._command_t,
            tilt=tilt(self.state.q[3:7]),
            status=self.result.status,
            drivers_damped=self.servo.state is ServoState.DAMPED,
            motion_active=self.laws.motion_active,
            gait_active=self.laws.gait_active,
            joint_fault=self.laws.joint_fault,
            coasting=0.0 if self._use_truth else self.estimator.health.coasting,
        )
        mode = self.supervisor.update(health, self.plant.t)
        if mode is Mode.DAMP and self.servo.state is ServoState.ACTIVE:
            self.servo.damp()
            self.controller.stop_motion()
        if mode is not before:
            self.enter_mode()
            faults = self.supervisor.faults
            self._note(f"mode {mode.value}" + (f": {'; '.join(faults)}" if faults else ""))

    def _drive(self, sensors: SensorData) -> None:
        """Drivers."""
        self.plant.write(self.servo.step(sensors.t, sensors.q, sensors.v, self.plant.period))
