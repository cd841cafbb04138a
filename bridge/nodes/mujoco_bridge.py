"""Node ``mujoco_bridge``: the simulated robot and its motor drivers behind the topics of a real one."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from bridge.loop_config import LoopConfig
from bridge.mujoco_plant import MujocoPlant
from bridge.ros.driven_robot import DrivenRobot
from bridge.ros.latency_probe import LatencyProbe
from bridge.ros.plant_services import PlantServices
from bridge.ros.run_loop import run_plant
from bridge.ros.sensor_publisher import SensorPublisher
from bridge.ros.slow_topics import SlowTopics
from models.config import default_config
from models.errors import MessageError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import JointCommandCodec
from models.nodes.parameters import describe
from models.nodes.qos import COMMAND, LATCHED
from models.nodes.spin import run
from models.types import Mode, SensorData

MODES = {mode.value: mode for mode in Mode}


class MujocoBridge(PoiseNode):
    """Publishes the sensors of every tick, applies the newest command, and steps the physics; ``run_plant`` paces it.

    Args:
        kwargs: Passed to rclpy.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("mujoco_bridge", **kwargs)
        self.lockstep = topics.declare_lockstep(self)
        get = self.declare_parameter
        self._seed = int(get("seed", 0, describe("Seed of the sensor noise", integer=(0, 2**63 - 1))).value)
        self._noise = bool(get("sensor_noise", True, describe("Noise, bias and quantisation of the profile")).value)
        self._payload = float(get("payload", 0.0, describe("Mass unknown to the laws [kg]", low=0.0, high=100.0)).value)
        slow = describe("Rate of /clock and /ground_truth/odom [Hz]", low=1.0, high=1000.0)
        self._slow_rate = float(get("slow_rate", 100.0, slow).value)
        self._config = default_config(LoopConfig, "bridge", "closed_loop")
        age = describe("Age of the sensors a command answers above which it is refused [s]", low=0.001, high=1.0)
        self._max_age = round(NANOSECONDS * float(get("max_command_age", self._config.max_command_age, age).value))
        self._latency_file = str(
            get("latency_file", "", describe("Where to write the latencies; empty for none")).value
        )
        self.tick, self._command_stamp = 1, 0  # a zero stamp means "now" in a command
        self._paused = False
        self._first: SensorData | None = None

    def configure(self) -> None:
        """Build the plant and the topics."""
        plant = MujocoPlant(self.model, seed=self._seed, sensor_noise=self._noise, payload_kg=self._payload)
        self._driven = DrivenRobot(plant, self._config)
        self.period = plant.period
        self._period_ns = round(plant.period * NANOSECONDS)
        self._slow_ticks = max(round(1.0 / (self._slow_rate * plant.period)), 1)
        self._probe = LatencyProbe() if self._latency_file else None
        self._sensors = SensorPublisher(self, reliable=self.lockstep)
        self._command_codec = JointCommandCodec(self.model)
        self._slow = SlowTopics(self, self._driven)
        self.listen(JointTrajectory, topics.JOINT_COMMAND, self._on_command, COMMAND, raw=True)
        self.listen(String, topics.MODE, self._on_mode, LATCHED)
        PlantServices(self, self._driven, self.restart, self._pause)

    def activate(self) -> None:
        """Hold the robot at its start and let it settle."""
        self.restart()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition; publishers work only from here on."""
        result = super().on_activate(state)
        self._slow.publish_latched(self.model.urdf.read_text(encoding="utf-8"))
        return result

    def deactivate(self) -> None:
        """Take the torque away and write what was measured."""
        self._driven.plant.close()
        if self._probe is not None:
            self._probe.save(Path(self._latency_file))

    def restart(self) -> None:
        """Put the robot back to its start; stamps go on."""
        self._driven.reset()
        settled = self._driven.hang()
        self._first = settled if self.lockstep else None
        self._slow.publish_state()

    @property
    def running(self) -> bool:
        """Whether simulated time passes."""
        return self.active and not self._paused

    @property
    def answered(self) -> bool:
        """Whether the drivers have the command of this tick."""
        return self._command_stamp == self.tick * self._period_ns

    @property
    def free_running(self) -> bool:
        """Whether the drivers take no commands although the robot was let go."""
        return not self._driven.plant.held and not self._driven.awaits_command

    def _pause(self, paused: bool) -> None:
        self._paused = paused

    def publish_tick(self, late: float) -> None:
        """Publish the sensors of this tick, which began so late after its deadline [s]."""
        stamp = self.tick * self._period_ns
        sensors = self._driven.plant.read() if self._first is None else self._first
        if self._probe is not None:
            self._probe.publish(self.tick, late, self._driven.state == topics.ACTIVE)
        self._sensors.publish(stamp, sensors)
        if self.tick % self._slow_ticks == 0:
            self.idle()
            self._slow.publish_truth(stamp)

    def step(self) -> None:
        """Advance by one tick."""
        self._driven.step()
        self._first = None
        self.tick += 1
        self._slow.publish_state()

    def overrun(self, ticks: int) -> None:
        """Count skipped ticks."""
        if ticks:
            self.counters["ticks skipped"] += ticks
            if self._probe is not None:
                self._probe.skip(self.tick, ticks)

    def idle(self) -> None:
        """Publish the time."""
        if self.active:
            self._slow.publish_time(self.tick * self._period_ns)

    def before_diagnostics(self) -> None:
        """Report what the drivers do."""
        if self.active:
            self.message = "paused" if self._paused else self._driven.state
            servo = self._driven.servo
            self.values["driver timeouts"], self.values["set-points refused"] = str(servo.timeouts), str(servo.refused)

    def _on_mode(self, message: String) -> None:
        if not self.active:
            return
        try:
            if message.data not in MODES:
                raise MessageError(f"unknown mode '{message.data[:32]}'; known: {', '.join(MODES)}")
            self._driven.set_mode(MODES[message.data])
        except PoiseError as error:
            self.refuse(topics.MODE, error)
        self._slow.publish_state()

    def _check_stamp(self, stamp: int) -> None:
        """Refuse a stamp [ns] that is not newer than the last command's, not yet due, or too old; 0 means now."""
        now = self.tick * self._period_ns
        if stamp and not self._command_stamp < stamp <= now:
            raise MessageError(f"header.stamp: {stamp} ns is not after {self._command_stamp} ns or not yet due")
        if stamp and now - stamp > self._max_age:
            self.counters["commands too old"] += 1
            raise MessageError(f"header.stamp: {stamp} ns is {now - stamp} ns old, more than {self._max_age} ns")

    def _on_command(self, data: bytes) -> None:
        if not self.active:
            return
        try:
            stamp, command = self._command_codec.decode(data)
            self._check_stamp(stamp)
            if self._driven.command(command):
                self._command_stamp = stamp or self._command_stamp
                if stamp and self._probe is not None:
                    self._probe.receive(stamp // self._period_ns)
        except PoiseError as error:
            self.refuse(topics.JOINT_COMMAND, error)


def main(args: list[str] | None = None) -> None:
    """Run the node in a process of its own."""
    sys.exit(run([MujocoBridge], args, run_plant))


if __name__ == "__main__":
    main()
