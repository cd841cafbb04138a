"""Joint drivers: modes and commands in, commands of the plant's drives out; no ROS."""

import numpy as np
import pinocchio as pin

from bridge.driver.foot_load import FootLoad
from bridge.driver.start_commands import StartState
from bridge.driver.startup import BEFORE_RELEASE, StartInputs, Startup
from bridge.plants.base import HardwarePlant, Plant, ReleaseGate, SimulatedPlant, hanging_command
from bridge.plants.config import LoopConfig
from controllers.estimation.assembler import mean_sample
from controllers.joints.joint_servo import JointServo, ServoState
from controllers.joints.motor_driver import MotorDriverConfig, follow_mode
from controllers.safety.supervisor import ACTIVE_MODES
from models.calibration import correct_encoders, encoder_command
from models.config import default_config
from models.errors import CommandError
from models.nodes import topics
from models.robot_model import RobotModel
from models.types import JointCommand, JointTrajectory, Mode, SensorData, Vector


class Drivers:
    """The joint drivers of any plant. A tick is ``read``, then ``act``.

    The drives have no torque until a mode with motion arms them. They damp when the plant has had no new sample for
    ``sensor_timeout`` of ``controllers/config/motor_driver.yaml``.

    ``keep_gains`` is an option of ``JointServo``, because a robot keeps its last command when its cable is cut.
    ``encoder_offsets`` (nj,) [rad], optional, may only change at the start, because the drives move a joint when its
    reading jumps. ``stale`` is the time since the last new sample [s]; ``interruptions`` counts how often the commands
    stopped while the robot was held.
    """

    def __init__(self, plant: Plant, model: RobotModel, *, keep_gains: bool = True) -> None:
        self.plant, self.servo = plant, JointServo(model, keep_gains=keep_gains)
        self.encoder_offsets: Vector | None = None
        self.stale = 0.0
        self.interruptions = 0
        self._stale_max = default_config(MotorDriverConfig, "controllers", "motor_driver").sensor_timeout
        self._mode = Mode.OFF
        self._sample: SensorData | None = None  # sample of this tick
        self._t = -1.0

    @property
    def t(self) -> float:
        """Stamp of the newest sample [s]."""
        return self._t

    @property
    def state(self) -> str:
        """State of the servo: ``active``, ``damped`` or ``off``."""
        return self.servo.state.value

    @property
    def awaits_command(self) -> bool:
        """Whether the drivers would execute a command of the controller."""
        return self._mode in ACTIVE_MODES and self.servo.state is ServoState.ACTIVE

    def read(self) -> SensorData:
        """Sample of this tick, with corrected encoder positions."""
        if self._sample is None:
            self._sample = correct_encoders(self.plant.read(), self.encoder_offsets)
            self.stale = 0.0 if self._sample.t > self._t else self.stale + self.plant.period
            self._t = self._sample.t
        return self._sample

    def act(self) -> None:
        """Last part of a tick: send the newest command to the drives."""
        sensors = self.read()
        if self.stale > self._stale_max and self.servo.state is ServoState.ACTIVE:
            self.servo.damp()
        command = self.servo.step(sensors.t, sensors.q, sensors.v, self.plant.period)
        self.plant.write(encoder_command(command, self.encoder_offsets))
        self._sample = None

    def set_mode(self, mode: Mode) -> None:
        """Apply the supervisor's mode; ``CommandError`` for off while the drivers are active (the robot would fall)."""
        follow_mode(self.servo, self._mode, mode)
        self._mode = mode

    def command(self, command: JointCommand | JointTrajectory) -> bool:
        """Pass a setpoint or trajectory to the drivers; returns whether they accept it, only in a mode with motion."""
        return self.awaits_command and self.servo.command(command, self.t)


class HardwareDrivers(Drivers):
    """The drivers of a real robot, with the start sequence of ``Startup``; monitors and remote controller can damp it.

    While the start sequence holds the robot, its command replaces the command of the joint servo. A fault of the servo,
    or the mode damp, ends the start in damping.
    """

    def __init__(self, plant: HardwarePlant, model: RobotModel) -> None:
        super().__init__(plant, model, keep_gains=plant.evaluates)
        self.plant: HardwarePlant = plant
        self.startup = Startup(model, crashed=plant.crashed, executed=plant.executed, own=plant.own_controller)
        self._load = FootLoad(model)
        self._model, self._data, self._neutral = model, model.data(), pin.neutral(model.pin)
        self._standing_height = self._height(model.posture("stand"))
        self._q = np.full(model.nj, np.nan)  # joint positions of the last tick (nj,) [rad]

    @property
    def state(self) -> str:
        """``hanging``, ``held`` until the stiff hold has faded, ``relaxing``, ``damped``, or the servo's state."""
        startup = self.startup
        if startup.supported:
            return topics.HANGING
        if startup.state is StartState.RELAX:
            return topics.RELAXING
        if startup.state is StartState.DAMPED:
            return topics.DAMPED
        return topics.HELD if startup.fading else super().state

    @property
    def awaits_command(self) -> bool:
        return self.startup.armable and super().awaits_command

    def set_mode(self, mode: Mode) -> None:
        """As ``Drivers``; ``CommandError`` also for a mode with motion before the robot stands on its feet."""
        startup = self.startup
        if mode in ACTIVE_MODES and not startup.armable:
            raise CommandError(
                f"mode '{mode.value}' refused in state '{startup.state}', which waits for {startup.waits_for}"
            )
        super().set_mode(mode)
        if mode is Mode.DAMP and startup.state not in BEFORE_RELEASE:
            startup.damp("mode damp was requested; if by the supervisor, poise status shows the fault")

    def relax(self) -> str:
        """Let a robot sink that stands still in a low posture; ``CommandError`` in any other state."""
        startup = self.startup
        if startup.state is StartState.STAND:
            height, limit = self._height(self._q) / self._standing_height, startup.config.relax_height
            if self._mode is not Mode.STAND:
                raise CommandError(
                    f"relax refused in mode '{self._mode.value}': send stop, then crouch, or request damp"
                )
            if not height < limit:
                raise CommandError(
                    f"relax refused: the base is at {100.0 * height:.0f} % of its standing height, below "
                    f"{100.0 * limit:.0f} % is required: send crouch first, or request damp"
                )
        return startup.relax()

    def _height(self, q: Vector) -> float:
        """Distance of the base from the midpoint of the soles [m] at joint positions (nj,) [rad]."""
        model = self._model
        self._neutral[7:] = q
        pin.framesForwardKinematics(model.pin, self._data, self._neutral)
        soles = [self._data.oMf[foot.frame_id].translation for foot in model.feet]
        return float(np.linalg.norm(np.mean(soles, axis=0)))

    def act(self) -> None:
        """As ``Drivers``, but sends no commands before the vendor's controller is released."""
        sensors, startup, servo = self.read(), self.startup, self.servo
        self._q = sensors.q
        stop = self.plant.stop
        if self.stale > self._stale_max:
            stop = stop or f"no new state of the robot for {self.stale:.3f} s"
        vendor = self.plant.vendor
        if startup.commands and vendor:
            stop = stop or f"{self.plant.own_controller} '{vendor}' is active again"
        if startup.state not in (StartState.STAND, StartState.RELAX):  # in these the supervisor checks the load
            self._load.update(sensors)
        command = servo.step(sensors.t, sensors.q, sensors.v, self.plant.period)
        if startup.state is StartState.STAND and servo.state is ServoState.DAMPED:
            stop = stop or f"no command of the controller for {servo.silence:.3f} s"
        if stop and startup.commands:
            servo.damp()
        findings = () if startup.commands and startup.state is not StartState.DAMPED else self.plant.findings
        doubts = () if startup.commands else self.plant.doubts
        inputs = StartInputs(
            sensors, findings, doubts, vendor, self._load.load, self._load.error, self._load.tilt,
            driven=self.awaits_command and servo.commanded, stop=stop, stale=self.stale, holds=self.plant.holds,
            pressed=self.plant.pressed, jumped=self.plant.jumped, foreign=self.plant.foreign,
        )  # fmt: skip
        if startup.update(inputs) is StartState.RELEASE:
            self.plant.release_vendor()
        if vendor and not startup.commands and self.plant.unfinished:
            self.plant.hand_over()
        given = startup.command(sensors, command)
        if given is not None:
            self.plant.write(encoder_command(given, self.encoder_offsets))
        self._sample = None


class SimulatedDrivers(Drivers):
    """The drivers of a simulated robot, which is held at the start until its feet bear its weight.

    While the robot is held, the drivers compensate gravity. In a mode with motion they execute commands; when both feet
    bear the weight, the base is released. If the commands stop before that, the drivers compensate gravity again and
    the next command restarts the transfer. No command moves a hanging robot. ``config`` has times and tolerances of the
    start.
    """

    def __init__(self, plant: SimulatedPlant, model: RobotModel, config: LoopConfig) -> None:
        super().__init__(plant, model, keep_gains=False)
        self.plant: SimulatedPlant = plant
        self._model, self._config = model, config
        self._at_rest = hanging_command(model)
        self.reset()

    def reset(self, *, hanging: bool = False) -> None:
        """Reset to the start: standing posture, held on the floor or hanging above it, no mode."""
        self.plant.reset()
        self._hanging = hanging
        if hanging:
            self.plant.hoist(self._config.hoist_height)
        self.servo.arm()
        self._mode = Mode.OFF
        self._sample, self._t = None, -1.0
        self._commanded = False
        self._gate: ReleaseGate | None = None

    @property
    def t(self) -> float:
        return self.plant.t

    @property
    def state(self) -> str:
        """``held``, ``hanging``, or the servo's state."""
        if not self.plant.held:
            return super().state
        return topics.HANGING if self._hanging else topics.HELD

    @property
    def movable(self) -> bool:
        """Whether the crane may lift or lower the robot: in mode off, if it is held or the servo is off."""
        return self._mode is Mode.OFF and (self.plant.held or self.servo.state is ServoState.OFF)

    def set_mode(self, mode: Mode) -> None:
        """As ``Drivers``, but a held robot stays held; ``CommandError`` also for a mode with motion while it hangs."""
        if self._hanging and mode in ACTIVE_MODES:
            raise CommandError(f"mode '{mode.value}' refused: the robot hangs in the air")
        if not self.plant.held:
            super().set_mode(mode)
        self._mode = mode
        if mode in ACTIVE_MODES:
            return
        self._commanded, self._gate = False, None
        if self.plant.held:
            self.servo.blend()

    def command(self, command: JointCommand | JointTrajectory) -> bool:
        """As ``Drivers``; the first command begins the transfer of a held robot's weight to its feet."""
        held = self.plant.held
        if held and self.awaits_command and not self._commanded:
            self.servo.blend()
        accepted = super().command(command)
        if accepted and held and self._gate is None:
            self._gate = ReleaseGate(self._model, self._config)
        self._commanded |= accepted
        return accepted

    def settle(self) -> SensorData:
        """Let a held robot come to rest without commands; returns the mean of the last samples."""
        period, samples = self.plant.period, []
        count, averaged = round(self._config.hang_time / period), round(self._config.average_time / period)
        for tick in range(count):
            self.step()
            if tick >= count - averaged:
                samples.append(self.read())
        return mean_sample(samples)

    def step(self) -> None:
        """One tick: drivers, physics and release."""
        self.act()
        self.plant.step()
        self.after_physics()

    def act(self) -> None:
        """As ``Drivers``; gravity compensation for a held robot without commands."""
        if self.plant.held:
            if self._commanded and self.servo.overdue(self.t):
                # the commands stopped before the release: compensate gravity instead of latched damping
                self.interruptions += 1
                self._commanded, self._gate = False, None
                self.servo.blend()
            if not self._commanded:
                self.servo.command(self._at_rest, self.t)
        super().act()

    def after_physics(self) -> None:
        """End of a tick: release the base once the feet bear the weight."""
        if self._gate is not None and self._gate.update(self.plant.load, self.plant.period):
            self.plant.release()
            self._gate = None
