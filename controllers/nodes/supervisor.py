"""Node ``supervisor``: modes, text commands, preflight and faults."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger

from controllers.commands.arbitration import PLAIN, ArbitrationConfig
from controllers.commands.command_signature import Verifier, read_key
from controllers.commands.obstacle_stop import ObstacleStop, ObstacleStopConfig
from controllers.nodes.command_topics import CommandTopics
from controllers.nodes.health_topics import REASON_MAX, HealthTopics
from controllers.nodes.preflight_probe import PreflightProbe
from controllers.safety.health import SupervisorConfig, fallen
from controllers.safety.preflight import attitude, preflight
from controllers.safety.supervisor import ACTIVE_MODES, Supervisor
from models.config import default_config
from models.nodes import topics
from models.nodes.base import PoiseNode, cause_of
from models.nodes.messages import clock_message
from models.nodes.parameters import declare, declare_config, declare_lockstep
from models.nodes.qos import EVENT, LATCHED, STATE
from models.nodes.services import offer_own
from models.nodes.spin import program
from models.status import MotionState, MotionStatus, SupervisorStatus
from models.types import CommandReply, Mode

SET_MODE, COMMAND = "set_mode", "command"  #: Services with types of this package, offered if these are built
#: Modes that can be requested by name
_SERVED = tuple(mode.value for mode in (Mode.OFF, Mode.DAMP, Mode.STAND, Mode.WALK))
_ACTIVE_NAMES = frozenset(mode.value for mode in ACTIVE_MODES)


class SupervisorNode(PoiseNode):
    """Runs ``Supervisor`` on the reports of the other nodes."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("supervisor", **kwargs)
        self._config = declare_config(self, default_config(SupervisorConfig, "controllers", "supervisor"))
        arbitration = default_config(ArbitrationConfig, "controllers", "arbitration")
        self._arbitration = declare_config(self, arbitration, "arbitration.")
        self._obstacle_stop = declare_config(
            self, default_config(ObstacleStopConfig, "controllers", "obstacle_stop"), "obstacle_stop."
        )
        self._lockstep, _ = declare_lockstep(self)
        text = "Whether to stand up by itself once the preflight checks pass and the robot is held"
        self._auto_stand = declare(self, "auto_stand", True, text)
        text = "Time between two checks of the robot's health [s]"
        self._period = declare(self, "period", 0.02, text, low=0.001, high=1.0)
        text = "Duration of a preflight check [s]"
        self._listen_time = declare(self, "preflight_time", 0.5, text, low=0.05, high=10.0)
        text = "Rate of each sensor topic [Hz]"
        self._sensor_rate = declare(self, "sensor_rate", 1000.0, text, low=1.0, high=10000.0)
        text = "Timeout of /clock, after which the robot is damped [s]"
        self._clock_timeout = declare(self, "clock_timeout", 0.5, text, low=0.01, high=60.0)
        text = "Maximum wait for the reports of a robot that stands when the supervisor starts [s]"
        self._adoption_time = declare(self, "adoption_time", 1.0, text, low=0.1, high=10.0)
        text = "Whether obstacles in the scan limit the velocity, where the robot has a scanner"
        self._look_ahead = declare(self, "look_ahead", True, text)
        text = "File with the key of signed commands; empty: unsigned commands are accepted"
        self._key_file = declare(self, "command_key", "", text)
        text = "Largest difference between the stamp of a signed command and the wall time [s]"
        self._key_window = declare(self, "command_window", 2.0, text, low=0.1, high=60.0)

    def configure(self) -> None:
        self._law = Supervisor(self.model, self._config)
        self._rates = {} if self._lockstep else dict.fromkeys(topics.sensor_topics(self.model), self._sensor_rate)
        self._probe, self._reports = PreflightProbe(self), HealthTopics(self, self._clock_timeout)
        self._driver_state = self._published = self._requested = ""
        self._requests = self._answered = 0
        self._last_answer = ""
        self._failed = False  # whether the last check had findings
        self._logged: list[str] | None = None  # causes of the findings that were logged last
        self._probe_until = self._adopting_until = time.monotonic()
        self._mode_topic = self.announce(String, topics.MODE, LATCHED)
        self._request = self.announce(String, topics.MOTION_REQUEST, EVENT)
        self._time = self.announce(Clock, topics.SUPERVISOR_TIME, STATE)
        obstacles = ObstacleStop(self.model, self._obstacle_stop) if self._look_ahead else None
        verifier = Verifier(read_key(Path(self._key_file)), self._key_window) if self._key_file else None
        self._commands = CommandTopics(
            self, self._arbitration, self._law, self._reports, self._act_on, obstacles, verifier
        )
        self.listen(String, topics.DRIVER_STATE, self._on_driver_state, LATCHED)
        self.listen_status(MotionStatus, topics.MOTION_STATUS, self._on_motion)
        self._publish_status = self.announce_status(topics.SUPERVISOR_STATUS, LATCHED)
        for name in _SERVED:
            self._offer(f"mode/{name}", partial(self._request_mode, Mode(name)))
        self._offer("estop", lambda: self._damped(self._law.estop()))
        self._offer("reset_faults", self._reset_faults)
        offer_own(self, "SetMode", SET_MODE, lambda call, reply: self._answer(reply, self._set_mode, call.mode))
        offer_own(self, "Command", COMMAND, lambda call, reply: self._answer(reply, self._command, call.text))
        self.own(PreflightProbe.stop, self._probe)
        self.own(self.destroy_timer, self.every(self._period, self._update))

    def deactivate(self) -> None:
        self._probe.stop()

    def before_diagnostics(self) -> None:
        if not self.active:
            return
        law = self._law
        reasons = (*law.faults, *law.holds)
        self.message = f"mode '{law.mode.value}'" + (f": {'; '.join(reasons)}" if reasons else "")
        self.level = (
            DiagnosticStatus.ERROR if law.faults else DiagnosticStatus.WARN if law.holds else DiagnosticStatus.OK
        )
        self._report()
        self.values["mode"], self.values["drivers"] = law.mode.value, self._driver_state
        self.values["preflight"] = "; ".join(law.preflight) or "passed"
        self.values["commands ignored"] = str(law.ignored)
        self.values |= self._commands.values()

    def _update(self) -> None:
        if not self.active:
            return
        law = self._law
        law.gait = self._reports.gait_present
        law.fallen = fallen(self._config, self._reports.tilt)
        law.held = self._driver_state == topics.HELD
        self._reports.moving = law.mode in ACTIVE_MODES
        if self._reports.moving:
            self._watch()
        elif not self._probe.open:
            if time.monotonic() >= self._probe_until:
                self._probe.start()
                self._probe_until = time.monotonic() + self._listen_time
        elif time.monotonic() >= self._probe_until:
            self._probe.stop()
            evidence = self._probe.evidence(self._reports.description, self._reports.incompatible)
            findings = preflight(self.model, self._config, evidence, self._rates)
            findings = (*self._unsupported(), *self._reports.intruders, *findings)
            self._log_preflight(findings)
            law.set_preflight(findings)
            self._probe_until += self._listen_time
            if self._auto_stand and self._driver_state == topics.HELD and not law.preflight and not law.faults:
                self._act_on("auto_stand", self._request_mode(Mode.STAND))
        self._time.publish(clock_message(self._reports.state_stamp))
        self._publish_mode()
        self._commands.publish()

    def _log_preflight(self, findings: tuple[str, ...]) -> None:
        """Log a new result; findings from the second check in a row that has some, since nodes start one by one."""
        causes = [cause_of(finding) for finding in findings]
        failed, self._failed = self._failed, bool(findings)
        if causes != self._logged and (failed or not findings):
            self._logged = causes
            self.get_logger().info(f"preflight: {'; '.join(findings) or 'passed'}")

    def _unsupported(self) -> tuple[str, ...]:
        """Reason why a hanging or a real damped robot cannot stand: the condition that its start waits for."""
        start = self._reports.start_status
        if start is not None and self._driver_state in (topics.HANGING, topics.DAMPED):
            return (f"start '{start.state}' waits for {start.waits_for[:REASON_MAX]}",)
        if self._driver_state == topics.HANGING:
            return ("the robot hangs in the air: lower it first (simulated: poise hang --down)",)
        return ()

    def _watch(self) -> None:
        if self._driver_state == topics.RELAXING:
            return  # the robot sinks on request and follows no command; only a request may damp it earlier
        if not self._reports.complete and time.monotonic() < self._adopting_until:
            return
        if self._reports.clock_silence(self._period) > self._clock_timeout:
            self._law.fault(f"no /clock for {self._clock_timeout} s: the driver has ended, or had no processor time")
        else:
            health, before = self._reports.health(self._driver_state, self._config), self._law.faults
            held = [cause_of(hold) for hold in self._law.holds]
            self._law.update(health, self._reports.t)
            if [cause_of(hold) for hold in self._law.holds] != held:
                self.get_logger().warning(f"hold: {'; '.join(self._law.holds) or 'over'}")
                self._report()
            for fault in before:
                if fault not in self._law.faults:
                    self.get_logger().info(f"over: {fault}")
            if self._law.mode is Mode.STAND and (new := set(self._law.faults).difference(before)):
                self.get_logger().error("; ".join(new))  # others are logged with the mode

    def _publish_mode(self) -> None:
        """Publish changes of mode and motion; nothing before the first driver state."""
        if not self._driver_state:
            return
        if self._published != self._law.mode.value:
            if self._law.mode in ACTIVE_MODES and self._published and self._published not in _ACTIVE_NAMES:
                self._reports.start()
            if self._law.mode is Mode.WALK:
                self._reports.walk()
            self._published = self._law.mode.value
            self._report()  # before the mode, so that a waiting client finds its reasons
            self.get_logger().info(f"mode {self._published}" + "".join(f"; {fault}" for fault in self._law.faults))
            self._mode_topic.publish(String(data=self._published))
        motion = self._law.take_motion()
        if motion is not None:
            self._requests += 1
            self._requested = motion if motion == topics.STOP_MOTION else f"{motion} {self._requests}"
            self._request.publish(String(data=self._requested))
        self._commands.take()

    def _act_on(self, source: str, reply: CommandReply) -> None:
        if reply.accepted:
            self.get_logger().info(f"{source}: {reply.reason}")
        else:
            self.refuse(source, reply.reason)
        self._answered, self._last_answer = self._answered + 1, reply.reason
        self._publish_mode()
        self._report()

    def _report(self) -> None:
        """Publish the status; called after each answered request, because its sender waits for it."""
        law = self._law
        status = SupervisorStatus(
            self.robot,
            law.mode,
            refused=self.counters[f"refused {topics.HUMANOID_COMMANDS}"],
            refusal=self.values.get("last refusal", ""),
            faults=law.faults,
            holds=law.holds,
            preflight=law.preflight,
            fallen=law.fallen,
            motion=law.motion or "",
            answered=self._answered,
            answer=self._last_answer,
            locks=self._commands.locks,
            obstacle=self._commands.obstacle,
        )
        self._publish_status(status)

    def _request_mode(self, mode: Mode) -> CommandReply:
        """Request a mode after a check of the newest attitude: a damped robot may have fallen just now."""
        law = self._law
        if law.mode not in ACTIVE_MODES and (law.fallen or not law.preflight):
            law.set_preflight((*self._unsupported(), *attitude(self._config, self._reports.tilt)))
        reply = law.request(mode)
        if mode is Mode.DAMP:
            return self._damped(reply)
        if mode is Mode.OFF and reply.accepted and self._reports.start_status is not None:
            return CommandReply(
                True,
                "off: the drives of a real robot follow its start; switch the robot off to remove all torque",
            )
        return reply

    def _damped(self, reply: CommandReply) -> CommandReply:
        """Publish mode ``damp`` again even if it is the present mode: the start of a real robot may have continued.

        The reply describes the effect on that start.
        """
        if self._law.mode is Mode.DAMP:
            self._published = ""
        start = self._reports.start_status
        if start is None or not reply.accepted:
            return reply
        answers = {
            "listen": "nothing is sent yet: use its stop function, or poise start damp if its controller is released",
            "release": "damped as soon as the robot's own controller has ended; until then use its stop function",
        }
        answers["gantry"] = answers["listen"]
        latched = "emergency stop is latched; " if self._law.stopped else ""
        return CommandReply(True, latched + answers.get(start.state, "joints are damped"))

    def _reset_faults(self) -> CommandReply:
        reply, start = self._law.reset_faults(), self._reports.start_status
        if start is None or start.state not in ("held", "loaded"):
            return reply
        return CommandReply(
            True, f"{reply.reason}; stand clear: the robot stands by itself when its feet bear the weight"
        )

    def _set_mode(self, name: str) -> CommandReply:
        if name not in _SERVED:
            reply = CommandReply(False, f"unknown mode '{name[:32]}'; known: {', '.join(_SERVED)}")
        else:
            reply = self._request_mode(Mode(name))
        self._act_on(SET_MODE, reply)
        return reply

    def _command(self, text: str) -> CommandReply:
        return self._commands.reply(PLAIN, COMMAND, text)

    def _offer(self, name: str, act: Callable[[], CommandReply]) -> None:
        def acted() -> CommandReply:
            reply = act()
            self._act_on(name, reply)
            return reply

        self.serve(Trigger, name, lambda request, response: self._answer(response, acted))

    def _answer(self, response: Any, act: Callable[..., CommandReply], *arguments: str) -> Any:
        """Response of a service; refused unless the node is active."""
        inactive = f"the supervisor is not active: ros2 lifecycle set {self.get_fully_qualified_name()} activate"
        reply = act(*arguments) if self.active else CommandReply(False, inactive)
        response.success, response.message = reply.accepted, reply.reason
        return response

    def _on_motion(self, status: MotionStatus) -> None:
        refused = status.state is MotionState.REFUSED and status.request == self._requested
        if refused and self._law.motion is not None:
            self._act_on(topics.MOTION_STATE, self._law.motion_refused(status.reason))

    def _on_driver_state(self, message: String) -> None:
        """Reset after a reset of the robot; take over a robot that is already active or damped.

        With active drivers the robot keeps standing. With damped drivers it stays damped, with a latched fault.
        """
        before, self._driver_state = self._driver_state, message.data
        stopped = self._law.stopped and self._reports.start_status is not None  # a simulated robot is reset
        if message.data == topics.HELD and before:
            self._law.reset(stopped=stopped)
            if before == topics.HANGING:  # the estimator restarts: evidence from the air is invalid
                self._probe.stop()
                self._probe_until = time.monotonic()
        elif message.data == topics.HANGING:
            self._law.reset(stopped=stopped)
            self._law.set_preflight(self._unsupported())
        elif message.data == topics.ACTIVE and before == "":
            self._law.reset(Mode.STAND)
            self._law.set_preflight(())
            self._adopting_until = time.monotonic() + self._adoption_time
        elif message.data == topics.DAMPED and before == "":
            self._law.reset(Mode.DAMP)
            self._law.fault("the drivers were damped when the supervisor started")
        elif message.data == topics.DAMPED:
            self._update()  # not at the next check: a request may arrive before it


main = program(SupervisorNode)


if __name__ == "__main__":
    main()
