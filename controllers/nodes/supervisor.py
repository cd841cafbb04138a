"""Node ``supervisor``: modes, text commands, preflight and faults; what moves the robot is decided here."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import String
from std_srvs.srv import Trigger

from controllers.arbitration_config import PLAIN, ArbitrationConfig
from controllers.command_key import read_key
from controllers.command_signature import Verifier
from controllers.health import second_publisher
from controllers.nodes.command_topics import CommandTopics
from controllers.nodes.health_topics import HealthTopics
from controllers.nodes.own_types import COMMAND, SET_MODE, offer_own_types
from controllers.nodes.preflight_probe import PreflightProbe
from controllers.obstacle_stop import ObstacleStop
from controllers.obstacle_stop_config import ObstacleStopConfig
from controllers.preflight import attitude, preflight
from controllers.supervisor import ACTIVE_MODES, Supervisor
from controllers.supervisor_config import SupervisorConfig
from models.config import default_config
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.parameters import declare_config, describe
from models.nodes.qos import EVENT, LATCHED
from models.nodes.spin import run
from models.types import CommandReply, Mode

_SERVED = tuple(mode.value for mode in (Mode.OFF, Mode.DAMP, Mode.STAND, Mode.WALK))
"""Modes that can be requested by name."""

_ACTIVE_NAMES = frozenset(mode.value for mode in ACTIVE_MODES)


class SupervisorNode(PoiseNode):
    """Runs ``Supervisor`` on what the other nodes report.

    Args:
        kwargs: Passed to rclpy.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("supervisor", **kwargs)
        self._config = declare_config(self, default_config(SupervisorConfig, "controllers", "supervisor"))
        arbitration = default_config(ArbitrationConfig, "controllers", "arbitration")
        self._arbitration = declare_config(self, arbitration, "arbitration.")
        self._obstacle_stop = declare_config(
            self, default_config(ObstacleStopConfig, "controllers", "obstacle_stop"), "obstacle_stop."
        )
        self._lockstep = topics.declare_lockstep(self)
        get = self.declare_parameter
        text = describe("Whether to stand up by itself once the preflight checks pass and the robot is held")
        self._auto_stand = bool(get("auto_stand", True, text).value)
        text = describe("Time between two looks at the robot's health [s]", low=0.001, high=1.0)
        self._period = float(get("period", 0.02, text).value)
        text = describe("How long a preflight check listens [s]", low=0.05, high=10.0)
        self._listen_time = float(get("preflight_time", 0.5, text).value)
        text = describe("Rate of each sensor topic [Hz]", low=1.0, high=10000.0)
        self._sensor_rate = float(get("sensor_rate", 1000.0, text).value)
        text = describe("Silence of /clock after which the robot is damped [s]", low=0.01, high=60.0)
        self._clock_timeout = float(get("clock_timeout", 0.5, text).value)
        text = describe(
            "How long a supervisor that starts beside a standing robot waits to hear of it [s]", low=0.1, high=10.0
        )
        self._adoption_time = float(get("adoption_time", 1.0, text).value)

        text = describe("Whether to look at the scan before each step, where the robot has a scanner")
        self._look_ahead = bool(get("look_ahead", True, text).value)
        text = describe("File with the key of signed commands; empty: unsigned ones are taken")
        self._key_file = str(get("command_key", "", text).value)
        text = describe("How far the stamp of a signed command may be from the wall time [s]", low=0.1, high=60.0)
        self._key_window = float(get("command_window", 2.0, text).value)

    def configure(self) -> None:
        """Build the law and the topics."""
        self._law = Supervisor(self.model, self._config)
        self._rates = {} if self._lockstep else dict.fromkeys(topics.sensor_topics(self.model), self._sensor_rate)
        self._probe, self._reports = PreflightProbe(self), HealthTopics(self, self._clock_timeout)
        self._driver_state = self._published = self._requested = ""
        self._requests = 0
        self._probe_until = self._adopting_until = time.monotonic()
        self._mode_topic = self.announce(String, topics.MODE, LATCHED)
        self._request = self.announce(String, topics.MOTION_REQUEST, EVENT)
        obstacles = ObstacleStop(self.model, self._obstacle_stop) if self._look_ahead else None
        verifier = Verifier(read_key(Path(self._key_file)), self._key_window) if self._key_file else None
        self._commands = CommandTopics(
            self, self._arbitration, self._law, self._reports, self._say, obstacles, verifier
        )
        self.listen(String, topics.DRIVER_STATE, self._on_driver_state, LATCHED)
        for topic in (topics.MOTION_STATE, topics.MOTION_PLAN_STATE):
            self.listen(String, topic, self._on_motion_state, EVENT)
        for name in _SERVED:
            self._offer(f"mode/{name}", lambda name=name: self._request_mode(Mode(name)))
        self._offer("estop", lambda: self._law.estop())
        self._offer("reset_faults", lambda: self._law.reset_faults())
        offer_own_types(self, self._set_mode, lambda text: self._commands.hear(PLAIN, COMMAND, text))
        self.own(PreflightProbe.stop, self._probe)
        self.own(self.destroy_timer, self.every(self._period, self._update))

    def deactivate(self) -> None:
        """Listen to the sensors no more."""
        self._probe.stop()

    def before_diagnostics(self) -> None:
        """Report mode, faults and what stands in the way of arming."""
        if not self.active:
            return
        law = self._law
        reasons = (*law.faults, *law.holds)
        self.message = f"mode '{law.mode.value}'" + (f": {'; '.join(reasons)}" if reasons else "")
        self.level = (
            DiagnosticStatus.ERROR if law.faults else DiagnosticStatus.WARN if law.holds else DiagnosticStatus.OK
        )
        self.values["mode"], self.values["drivers"] = law.mode.value, self._driver_state
        self.values["preflight"] = "; ".join(law.preflight) or "passed"
        self.values["commands ignored"] = str(law.ignored)
        self.values |= self._commands.values()

    def _update(self) -> None:
        """Health to mode, preflight, and what changed."""
        if not self.active:
            return
        law = self._law
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
            intruders = map(second_publisher, self._reports.intruders)
            findings = (*self._hanging(), *intruders, *findings)
            if findings != law.preflight:
                self.get_logger().info(f"preflight: {'; '.join(findings) or 'passed'}")
            law.set_preflight(findings)
            self._probe_until += self._listen_time
            if self._auto_stand and self._driver_state == topics.HELD and not law.preflight and not law.faults:
                self._say("auto_stand", self._request_mode(Mode.STAND))
        self._publish_mode()
        self._commands.tell()

    def _hanging(self) -> tuple[str, ...]:
        """Nothing stands on a floor that it does not touch."""
        return ("the robot hangs in the air: let it down first",) if self._driver_state == topics.HANGING else ()

    def _watch(self) -> None:
        if not self._reports.heard and time.monotonic() < self._adopting_until:
            return
        if time.monotonic() - self._reports.clock_seen > self._clock_timeout:
            self._law.fault(f"no /clock for {self._clock_timeout} s: the plant is gone")
        else:
            health = self._reports.health(self._driver_state, self._config)
            self._law.update(health, self._reports.t)

    def _publish_mode(self) -> None:
        """Tell what has changed; nothing before the drivers have told what they do."""
        if not self._driver_state:
            return
        if self._published != self._law.mode.value:
            if self._law.mode in ACTIVE_MODES and self._published and self._published not in _ACTIVE_NAMES:
                self._reports.start()
            if self._law.mode is Mode.WALK:
                self._reports.walk()
            self._published = self._law.mode.value
            self.get_logger().info(f"mode {self._published}" + "".join(f"; {fault}" for fault in self._law.faults))
            self._mode_topic.publish(String(data=self._published))
        motion = self._law.take_motion()
        if motion is not None:
            self._requests += 1
            self._requested = motion if motion == topics.STOP_MOTION else f"{motion} {self._requests}"
            self._request.publish(String(data=self._requested))
        self._commands.take()

    def _say(self, source: str, reply: CommandReply) -> None:
        """Log a reply and act on it at once."""
        if reply.accepted:
            self.get_logger().info(f"{source}: {reply.reason}")
        else:
            self.refuse(source, reply.reason)
        self._publish_mode()

    def _request_mode(self, mode: Mode) -> CommandReply:
        """Ask the law for a mode, after a last look at the attitude: a damped robot may have fallen just now."""
        law = self._law
        if law.mode not in ACTIVE_MODES and not law.preflight:
            law.set_preflight(tuple(attitude(self._config, self._reports.tilt)))
        law.gait = self._reports.gait_present
        return law.request(mode)

    def _set_mode(self, name: str) -> CommandReply:
        """Ask for a mode by its name."""
        if name not in _SERVED:
            reply = CommandReply(False, f"unknown mode '{name[:32]}'; known: {', '.join(_SERVED)}")
        else:
            reply = self._request_mode(Mode(name))
        self._say(SET_MODE, reply)
        return reply

    def _offer(self, name: str, act: Any) -> None:
        def on_call(request: Any, response: Any) -> Any:
            if not self.active:
                response.success, response.message = False, "the supervisor is not active"
                return response
            reply = act()
            response.success, response.message = reply.accepted, reply.reason
            self._say(name, reply)
            return response

        self.serve(Trigger, name, on_call)

    def _on_motion_state(self, message: String) -> None:
        word, _, reason = message.data.partition(": ")
        request, _, reason = reason.partition(": ")
        if word == topics.MOTION_REFUSED and request == self._requested and self._law.motion is not None:
            self._say(topics.MOTION_STATE, self._law.motion_refused(reason))

    def _on_driver_state(self, message: String) -> None:
        """A robot put back to its start begins anew. When this node starts beside one that moves, it takes over.

        Active drivers: the robot keeps standing. Damped ones: it stays damped, with a latched fault.
        """
        before, self._driver_state = self._driver_state, message.data
        if message.data == topics.HELD and before:
            self._law.reset()
        elif message.data == topics.HANGING:
            self._law.reset()
            self._law.set_preflight(self._hanging())
        elif message.data == topics.ACTIVE and before == "":
            self._law.reset(Mode.STAND)
            self._law.set_preflight(())
            self._adopting_until = time.monotonic() + self._adoption_time
        elif message.data == topics.DAMPED and before == "":
            self._law.reset(Mode.DAMP)
            self._law.fault("the drivers were damped when the supervisor started")


def main(args: list[str] | None = None) -> None:
    """Run the node in a process of its own."""
    sys.exit(run([SupervisorNode], args))


if __name__ == "__main__":
    main()
