"""Start of a real robot, from its vendor's controller to standing, as a state machine without ROS.

    listen -> gantry -> release -> damp -> prepare -> hanging -> held -> loaded -> stand
                                                         any of these from release on -> damped -> damp, or listen
                                                         stand -> relax -> damped

No commands are sent before the end of ``release``, unless no other controller commands the robot and damping is
requested. After a crash of the last driver, ``listen`` waits until the robot and the state of the vendor's controller
are known, and sends no commands unless the operator requests damping. Then a robot without an active controller is
``damped``; with one the start begins again. ``gantry`` waits for the operator's confirmation that the robot hangs from
a gantry, ``hanging`` for ``lower``. From the confirmation until ``hanging`` the robot must hang upright, without load
on its feet. It is damped when it topples before it stands by itself. A hold of the monitors prevents lowering. After a
jump of the robot's clock, or a gap between ticks above ``sensor_timeout`` of ``controllers/config/motor_driver.yaml``,
the robot is damped from the measured torques. ``held`` is stiff in the standing posture until the load on the feet,
computed from the joint torques, equals the weight. The stiff hold includes the torques of that load at the measured
posture: gravity does not reduce its stiffness, and an error of the model's CoM makes the robot lean less. ``loaded``
stays stiff until the joint drivers execute commands, which then replace the stiff hold over the time ``fade``. If the
robot is lifted before that, it is ``held`` again. ``damped`` waits for the operator to hang the robot up. When the
vendor's controller becomes active, all commands end and the start begins again.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from bridge.driver.start_commands import StartCommands, StartState, StartupConfig, stiff_hold_acts
from controllers.joints.motor_driver import MotorDriverConfig
from models.config import default_config
from models.errors import CommandError
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData, Vector

#: States without commands; the vendor's controller commands the robot, unless it was released before
BEFORE_RELEASE = (StartState.LISTEN, StartState.GANTRY)
#: States with the stiff hold, on the rope or on the feet, without balance control
_STIFF = (StartState.PREPARE, StartState.HANGING, StartState.HELD, StartState.LOADED)
_WAITS = {
    StartState.GANTRY: "the operator: hang the robot from its gantry, then poise start confirm_gantry",
    StartState.HANGING: "the operator: poise start lower, then lower the robot onto its feet",
    StartState.LOADED: "the supervisor: mode 'stand'",
    StartState.STAND: "",
}


class StartInputs(NamedTuple):
    """Inputs of one tick of the start."""

    sensors: SensorData
    findings: Sequence[str] = ()  # why the robot's messages cannot be used
    doubts: Sequence[str] = ()  # why even damping must not be commanded
    vendor: str | None = None  # name of the vendor's active controller, empty when released, None while unknown
    load: float = 0.0  # vertical force on both feet relative to the weight [-]
    load_error: float = 0.0  # error of the load [-]
    tilt: float = 0.0  # tilt of the base [rad]
    driven: bool = False  # whether the joint drivers execute commands
    stop: str = ""  # reason for immediate damping
    jumped: bool = False  # whether the robot's clock jumped; the time since the last tick is then unknown
    stale: float = 0.0  # age of the sample [s]
    holds: Sequence[str] = ()  # holds of the monitors
    pressed: str = ""  # pressed stop button of the remote controller
    foreign: bool = False  # whether another program sends commands


class Startup:
    """The state machine. A tick is ``update``, then ``command``.

    ``crashed`` is whether the last driver ended without damping the robot. Then only damping is possible, unless the
    vendor's controller is active. ``executed`` maps a command to the command that the robot executes; after a fault its
    torque fades. ``own`` is the name of the vendor's controller in messages; empty without one. The operator's methods
    raise ``CommandError`` with the reason of a refusal.
    """

    def __init__(
        self,
        model: RobotModel,
        config: StartupConfig | None = None,
        *,
        crashed: bool = False,
        executed: Callable[[JointCommand], JointCommand] = lambda command: command,
        own: str = "",
    ) -> None:
        self._own = own
        self.config = config or default_config(StartupConfig, "bridge", "startup")
        self._tick_max = default_config(MotorDriverConfig, "controllers", "motor_driver").sensor_timeout  # [s]
        self.model = model
        self.state = StartState.LISTEN
        self.reason = ""  #: Why the robot is damped, or was not released
        self.load = 0.0  #: Load on the feet relative to the weight, averaged over ``load_window`` [-]
        self._load_error = 0.0  # error of the newest load [-]
        self.tilt = np.nan  #: Tilt of the base, averaged over ``load_window`` [rad]
        self._crashed = crashed
        self._drives = StartCommands(model, self.config, executed)
        self._monitor_holds: Sequence[str] = ()  # present holds of the monitors
        self._vendor: str | None = None
        self._stopped = ""  # reason to damp once the vendor's controller has ended
        self._toppled = 0.0  # time for which the base has been tilted too far [s]
        self._elapsed = 0.0  # time in this state by the robot's clock; advances without samples, too [s]
        self._good = 0.0  # time for which the condition of the state has held [s]
        self._t: float | None = None
        self._findings: Sequence[str] = ("no message of the robot yet",)
        self._doubts: Sequence[str] = self._findings
        if crashed:
            self.reason = "the driver ended without damping the robot"

    @property
    def waits_for(self) -> str:
        """Condition that ends the present state; empty for none."""
        state, config = self.state, self.config
        before = f"{self._without_own} (before: {self.reason})" if self.reason else self._without_own
        if state is StartState.HANGING and (reasons := "; ".join(filter(None, (*self._monitor_holds, self.grounded)))):
            return f"{_WAITS[state]} ({reasons})"
        if state in _WAITS:
            return f"{_WAITS[state]}{before}"
        if state is StartState.LISTEN and self._crashed:
            return self._unknown
        then = f", then it is damped ({self._stopped})" if self._stopped else ""
        if state is StartState.LISTEN:
            return ("; ".join(self._findings) or f"checks to pass for {config.listen_time:g} s") + then + before
        if state is StartState.RELEASE:
            return ("; ".join(self._findings) or self._released) + then
        if state is StartState.DAMP:
            return f"the joints to be slower than {config.rest_speed:g} rad/s for {config.settle_time:g} s"
        if state is StartState.PREPARE:
            return f"the ramp to the standing posture, {max(self._drives.ramp - self._elapsed, 0.0):.1f} s"
        if state is StartState.RELAX:
            return f"the robot to sink, {max(config.relax_time - self._elapsed, 0.0):.1f} s"
        if state is StartState.HELD:
            return "; ".join(self._monitor_holds) or f"the weight on the feet: {100.0 * self.load:.0f} %"
        if self._crashed:
            return f"the operator: hang the robot up, end poise up with Ctrl-C and start it again ({self.reason})"
        return f"the operator: hang the robot up, then poise start prepare (damped: {self.reason})"

    @property
    def _unknown(self) -> str:
        """Condition that ends ``listen`` after a crash."""
        doubts = "; ".join(self._doubts) or f"{self.config.quiet_time:g} s without a sign of another controller"
        found = f"{doubts}: nothing is commanded, because another controller may be active ({self.reason})"
        if self._elapsed <= self.config.answer_timeout:
            return found
        return (
            f"{found}; the robot may still execute the last command: secure it with its rope, then switch it off, or, "
            f"if no other controller commands it, use poise start damp or its stop button"
        )

    @property
    def _without_own(self) -> str:
        """Note that the vendor's controller is inactive before this computer commands the robot; else empty."""
        if self.state not in BEFORE_RELEASE or self._vendor != "" or not self._own:
            return ""
        return (
            f"; {self._own} is released: the robot is limp, or executes what another program commands; "
            f"poise start damp damps it"
        )

    @property
    def _released(self) -> str:
        """Condition that ends ``release``."""
        return f"{self._own} to end" if self._own else "the command controller to be active"

    @property
    def commands(self) -> bool:
        """Whether this computer commands the drives."""
        return self.state not in (*BEFORE_RELEASE, StartState.RELEASE)

    @property
    def supported(self) -> bool:
        """Whether the rope or the vendor's controller supports the robot."""
        return self.state not in (StartState.LOADED, StartState.STAND, StartState.RELAX, StartState.DAMPED)

    @property
    def armable(self) -> bool:
        """Whether the joint drivers may be armed."""
        return self.state in (StartState.LOADED, StartState.STAND)

    @property
    def fading(self) -> bool:
        """Whether the stiff hold still acts."""
        return stiff_hold_acts(self.state, self._elapsed, self.config)

    def confirm_gantry(self) -> str:
        """Confirm that the robot hangs from its gantry; the vendor's controller is released."""
        self._require("confirm_gantry", StartState.GANTRY)
        self._require_hanging("confirm_gantry")
        self._enter(StartState.RELEASE)
        released = f"{self._own} is released; then the robot, which is limp," if self._own else "the robot"
        return f"{released} is damped, and moves to the standing posture by itself: keep clear"

    def lower(self) -> str:
        """Begin to lower the robot."""
        self._require("lower", StartState.HANGING)
        if self._monitor_holds:
            raise CommandError(f"lower refused: {'; '.join(self._monitor_holds)}")
        if not self.tilt < self.config.tilt_max:
            raise CommandError(f"lower refused: {self.grounded}; hang the robot upright, and request it again")
        lowered = self.grounded
        self._enter(StartState.HELD)
        self.load = 0.0  # its torques begin without a step
        if lowered:
            return f"accepted, stand clear: {lowered}, so it stands by itself within a second; keep the rope at hand"
        return "lower the robot; it stands by itself when its feet bear the weight"

    def prepare(self) -> str:
        """Confirm that the damped robot has been hung up again; the joints move to the standing posture."""
        self._require("prepare", StartState.DAMPED)
        if self._crashed:
            raise CommandError(f"prepare refused: {self.waits_for}")
        if self._findings:
            raise CommandError(f"prepare refused: {'; '.join(self._findings)}")
        self._require_hanging("prepare")
        self._enter(StartState.DAMP)
        return "the joints move to the standing posture"

    def damp(self, reason: str) -> str:
        """Damp the robot immediately; in ``release`` once the vendor's controller has ended, even if a check fails.

        Refused while the vendor's controller commands the robot, or may do so. After a crash an unknown state of that
        controller does not prevent damping, because the operator can see the robot.
        """
        if self.state is StartState.RELEASE and self._vendor != "":
            self._stopped = self._stopped or reason
            return f"joints are damped as soon as {self._own} has ended; until then use its stop function"
        if self.state in BEFORE_RELEASE and not self._limp:
            doubts = "; ".join(self._doubts) if self._vendor == "" else "nothing is commanded yet"
            stops = f", or that of {self._own}" if self._own and self._vendor != "" else ""
            raise CommandError(f"damp refused: {doubts}; use the stop function of the robot{stops}")
        if self.state is not StartState.DAMPED:
            self.reason = reason
            self._enter(StartState.DAMPED)
        return "joints are damped"

    @property
    def _limp(self) -> bool:
        """Whether neither this computer nor, as far as known, another controller commands the robot."""
        return not self.commands and ((self._crashed and not self._vendor) or (self._vendor == "" and not self._doubts))

    def relax(self) -> str:
        """Let the standing robot sink slowly from a low posture, without balance control."""
        self._require("relax", StartState.STAND)
        self._drives.keep_last()
        self._enter(StartState.RELAX)
        return "the robot sinks, then it is damped"

    def update(self, inputs: StartInputs) -> StartState:
        """One tick; returns the state."""
        sensors, config = inputs.sensors, self.config
        # The time advances without samples, so that the torque fades, but not before the first sample.
        t = sensors.t + inputs.stale if sensors.t > 0.0 else 0.0
        dt = 0.0 if self._t is None else max(t - self._t, 0.0)
        self._t, self._findings = t, inputs.findings
        self._doubts, self._monitor_holds, self._vendor = inputs.doubts, inputs.holds, inputs.vendor
        if self._crashed and self.state is StartState.LISTEN and np.isfinite(sensors.tau).all():
            self._drives.fade_from(sensors.tau)  # torques of the last driver's command
        if self.commands and (dt > self._tick_max or inputs.jumped):
            self._drives.fade_from(sensors.tau)  # the guard may have damped since the last command
            hung = f"{dt:.3f} s between two ticks of the driver, {self._tick_max:g} s at most"
            inputs = inputs if inputs.jumped else inputs._replace(stop=inputs.stop or hung)
        self._elapsed += dt
        share = min(dt / config.load_window, 1.0)
        self.tilt = self.tilt + share * (inputs.tilt - self.tilt) if np.isfinite(self.tilt) else inputs.tilt
        self.load += share * (inputs.load - self.load) if np.isfinite(inputs.load) else -share * self.load
        self._load_error = float(np.nan_to_num(inputs.load_error))
        self._toppled = self._toppled + dt if self.tilt > config.topple_tilt else 0.0
        if self.state is StartState.DAMPED:
            self._hand_over(inputs, dt)
        elif inputs.pressed and self._limp:
            self.damp(inputs.pressed)
        elif self._crashed:
            self._recover(inputs, dt)
        elif self._stopped and self.state is StartState.LISTEN and not inputs.vendor:
            if self._holds(self._limp and not inputs.foreign, dt, config.quiet_time):
                self.damp(self._stopped)
        elif inputs.stop:
            self._stop(inputs)
        elif self.state in _STIFF and self._toppled > config.topple_time:
            self.damp(f"the base is tilted by {self.tilt:.2f} rad, {config.topple_tilt:g} rad at most")
        elif self.state is StartState.LISTEN:
            if self._holds(not inputs.findings, dt, config.listen_time):
                self._enter(StartState.GANTRY)
        elif self.state is StartState.GANTRY:
            if inputs.findings:
                self._enter(StartState.LISTEN)
        elif self.state is StartState.RELEASE:
            self._release(inputs, dt)
        elif self.state is StartState.DAMP:
            if self._holds(bool(np.abs(sensors.v).max() < config.rest_speed), dt, config.settle_time):
                self._enter(StartState.PREPARE)
                self._drives.begin_ramp(sensors.q)
        elif self.state is StartState.PREPARE:
            if self._holds(bool(self.grounded), dt, config.load_time):
                self.damp(self.grounded)
            else:
                self._follow_ramp(sensors.q)
        elif self.state is StartState.HANGING:
            self._damp_behind(sensors.q)
        elif self.state is StartState.HELD:
            stands = abs(self.load - 1.0) < config.load_tolerance and self.tilt < config.tilt_max
            if self._holds(stands and not inputs.holds, dt, config.load_time):
                self._enter(StartState.LOADED)
        elif self.state is StartState.LOADED:
            if inputs.holds:
                self._enter(StartState.HELD)
            elif inputs.driven:
                self._enter(StartState.STAND)
            elif self._holds(abs(self.load - 1.0) > 2.0 * config.load_tolerance, dt, config.load_time):
                self._enter(StartState.HELD)
        elif self.state is StartState.RELAX and self._elapsed >= config.relax_time:
            self.damp("the robot was lowered")
        return self.state

    def command(self, sensors: SensorData, driver: JointCommand) -> JointCommand | None:
        """Command of the drives, given the command of the joint drivers (``driver``); None while none may be sent."""
        if not self.commands:
            return None
        return self._drives.command(self.state, self._elapsed, self.load, sensors, driver)

    def _require(self, name: str, state: StartState) -> None:
        if self.state is not state:
            next_step = f"; the start waits for {self.waits_for}" if self.waits_for else ""
            raise CommandError(f"{name} refused in state '{self.state}': it needs state '{state}'{next_step}")

    def _require_hanging(self, name: str) -> None:
        if self.grounded:
            raise CommandError(
                f"{name} refused: {self.grounded}; hang the robot upright, its feet in the air, and request it again"
            )

    @property
    def grounded(self) -> str:
        """Why the robot does not hang upright with its feet in the air; empty when it does."""
        if np.isnan(self.tilt):
            return "the tilt of the base is not known yet"
        if not self.tilt < self.config.tilt_max:
            return f"the base is tilted by {self.tilt:.2f} rad, {self.config.tilt_max:g} rad at most"
        if self.load - self._load_error > self.config.hang_load_max:
            return f"the feet bear {self.load:.0%} of the weight, {self.config.hang_load_max:.0%} at most"
        return ""

    def _enter(self, state: StartState) -> None:
        self.state, self._elapsed, self._good = state, 0.0, 0.0
        if state is not StartState.LISTEN:  # the vendor's controller may still end there after an abandoned release
            self._stopped = ""
        if state not in (StartState.DAMPED, *BEFORE_RELEASE):
            self.reason = ""

    def _holds(self, condition: bool, dt: float, time: float) -> bool:
        """Whether a condition has been true for a time [s]."""
        self._good = self._good + dt if condition else 0.0
        return condition and self._good >= time

    def _stop(self, inputs: StartInputs) -> None:
        """Damp the robot. Before the release, or with failed checks during it, restart without commands."""
        if self.state in BEFORE_RELEASE or (self.state is StartState.RELEASE and inputs.findings):
            self._findings = tuple(dict.fromkeys((inputs.stop, *inputs.findings)))
            self._enter(StartState.LISTEN)
        else:
            self.damp(inputs.stop)

    def _hand_over(self, inputs: StartInputs, dt: float) -> None:
        """End all commands of a damped robot once its vendor's controller is active, which must be the only one."""
        if self._holds(bool(inputs.vendor), dt, self.config.hand_over_time):
            self._crashed = False
            self._enter(StartState.LISTEN)
            self.reason = f"{self._own} '{inputs.vendor}' became active"

    def _recover(self, inputs: StartInputs, dt: float) -> None:
        """After a crash: restart without commands if the vendor's controller is active; damp if none is."""
        if inputs.vendor:
            self._crashed = False
            self.reason = f"{self._own} '{inputs.vendor}' is active after a crash of the driver"
        elif self._holds(inputs.vendor == "" and not inputs.doubts, dt, self.config.quiet_time):
            self.damp(self.reason)

    def _release(self, inputs: StartInputs, dt: float) -> None:
        if self._holds(inputs.vendor == "" and not inputs.findings, dt, self.config.quiet_time):
            if self._stopped:
                self.damp(self._stopped)
            else:
                self._enter(StartState.DAMP)
        elif self._elapsed > self.config.release_timeout:
            active = "its state is unknown" if inputs.vendor is None else f"'{inputs.vendor}' is active"
            reason = "; ".join(inputs.findings) if inputs.vendor == "" else f"waited for {self._released}: {active}"
            self._enter(StartState.LISTEN)
            self.reason = reason

    def _follow_ramp(self, q: Vector) -> None:
        if not self._damp_behind(q) and self._elapsed >= self._drives.ramp and not self.grounded:
            self._enter(StartState.HANGING)

    def _damp_behind(self, q: Vector) -> bool:
        """Damp a robot in the air if a joint is blocked away from its reference; returns whether it did."""
        behind = np.abs(self._drives.reference(self.state, self._elapsed) - q)
        if not behind.max() > self.config.ramp_error:
            return False
        worst = int(behind.argmax())
        self.damp(f"joint '{self.model.joint_names[worst]}' is {behind[worst]:.2f} rad off its reference")
        return True
