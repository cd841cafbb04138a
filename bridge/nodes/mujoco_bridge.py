"""Node ``mujoco_bridge``: the simulated robot and its motor drivers behind the topics of a real one."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from bridge.mujoco_plant import MujocoPlant
from bridge.mujoco_world import ALONE, Place
from bridge.ros.bridge_parameters import BridgeParameters, declare
from bridge.ros.bridged_world import BridgedWorld, robot_name
from bridge.ros.command_input import CommandInput
from bridge.ros.driven_robot import DrivenRobot
from bridge.ros.latency_probe import LatencyProbe
from bridge.ros.obstacle_service import ObstacleService
from bridge.ros.plant_services import PlantServices
from bridge.ros.run_loop import run_plant
from bridge.ros.scan_publisher import ScanPublisher
from bridge.ros.sensor_publisher import SensorPublisher
from bridge.ros.slow_topics import SlowTopics
from bridge.sensor_errors import read_sensor_errors
from models.errors import ConfigError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.calibration_file import NO_FILE, CalibrationFile
from models.nodes.cdr import NANOSECONDS
from models.nodes.spin import run
from models.types import SensorData


class MujocoBridge(PoiseNode):
    """Publishes the sensors of every tick, applies the newest command, and steps the physics; ``run_plant`` paces it.

    Args:
        world: Of several robots, each with a bridge; one of its own when None.
        kwargs: Passed to rclpy.

    Attributes:
        paused: Whether simulated time stands still.
        slow_ticks: Ticks between two messages of ``clock`` and ``ground_truth/odom``.
    """

    callbacks_min = 1

    def __init__(self, world: BridgedWorld | None = None, **kwargs: Any) -> None:
        super().__init__("mujoco_bridge", **kwargs)
        self._given = declare(self)
        self.lockstep = self._given.lockstep
        self.tick = 1
        self.paused = False
        self._world = world
        if world is not None:
            world.bridges.append(self)
        self._first: SensorData | None = None

    def configure(self) -> None:
        """Build the plant and the topics."""
        given = self._given
        if self._world is None and given.place != Place():
            raise ConfigError("place: a robot that has the world for itself begins at its origin")
        plant = MujocoPlant(
            self.model,
            seed=given.seed,
            sensor_noise=given.sensor_noise,
            payload_kg=given.payload,
            terrain=given.terrain,
            sensor_errors=read_sensor_errors(given.sensor_errors),
            faults=given.faults,
            world=None if self._world is None else self._world.world,
            name=ALONE if self._world is None else robot_name(self),
        )
        self._driven = DrivenRobot(plant, given.config)
        self.period = plant.period / given.speed
        self._period_ns = round(plant.period * NANOSECONDS)
        self._sensor_ticks = _ticks_between(given.sensor_rate, plant.period)
        self.slow_ticks = max(round(1.0 / (given.slow_rate * plant.period)), 1)
        self._probe = LatencyProbe() if given.latency_file else None
        self._sensors = SensorPublisher(self, plant, reliable=self.lockstep)
        noise = float(given.sensor_noise)
        self._scan = ScanPublisher(self, plant, seed=given.seed, noise=noise, reliable=self.lockstep)
        self._slow = SlowTopics(self, self._driven)
        tell = self._slow.publish_state
        self.commands = CommandInput(self, self._driven, self._period_ns, given.max_age, self._probe, tell)
        self._calibration = CalibrationFile(self, NO_FILE)
        PlantServices(self, self._driven, self.restart, self._pause)
        ObstacleService(self, plant)

    @property
    def given(self) -> BridgeParameters:
        """What was asked for."""
        return self._given

    @property
    def driven(self) -> DrivenRobot:
        """The robot with its drivers; there is none before the node is configured."""
        return self._driven

    def activate(self) -> None:
        """Hold the robot at its start and let it settle."""
        self.restart()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition; publishers work only from here on."""
        result = super().on_activate(state)
        self._slow.publish_latched(self.model.urdf.read_text(encoding="utf-8"), self.stamp)
        return result

    def deactivate(self) -> None:
        """Take the torque away and write what was measured."""
        self._driven.plant.close()
        if self._probe is not None:
            self._probe.save(Path(self._given.latency_file))

    def restart(self, hanging: bool = False) -> None:
        """Put the robot back to its start, or into the air, with the newest calibration; stamps go on."""
        offsets = self._calibration.read().encoder_offsets
        self._driven.encoder_offsets = offsets if offsets.any() else None
        self._driven.reset(hanging=hanging)
        settled = self._driven.settle()
        self._first = settled if self.lockstep else None
        self._slow.publish_start(self.stamp)

    @property
    def stamp(self) -> int:
        """Stamp of this tick [ns]."""
        return self.tick * self._period_ns

    @property
    def running(self) -> bool:
        """Whether simulated time passes."""
        return self.active and not self.paused

    @property
    def answered(self) -> bool:
        """Whether the drivers have the command of this tick, or nobody computes one: no sensors were sent, a fault."""
        return self.commands.stamp == self.stamp or not self._sensing or self._driven.plant.faults.spoilt

    @property
    def _sensing(self) -> bool:
        """Whether the sensors of this tick are published."""
        return self.tick % self._sensor_ticks == 0

    @property
    def free_running(self) -> bool:
        """Whether the drivers take no commands although nothing is being waited for: let go, or in the air."""
        return self._driven.state != topics.HELD and not self._driven.awaits_command

    def _pause(self, paused: bool) -> None:
        self.paused = paused

    def publish_tick(self, late: float) -> None:
        """Publish the sensors of this tick, which began so late after its deadline [s]."""
        self.commands.now = self.stamp
        if self._sensing:
            self._publish_sensors(late)
        self._scan.publish(self.tick, self.stamp)
        if self.tick % self.slow_ticks == 0:
            self.idle()
            self._slow.publish_truth(self.stamp)

    def _publish_sensors(self, late: float) -> None:
        if self._probe is not None:
            self._probe.publish(self.tick, late, self._driven.state == topics.ACTIVE)
        self._sensors.publish(self.stamp, self._driven.read() if self._first is None else self._first)
        if self._probe is not None:
            self._probe.send(self.tick)

    def step(self) -> None:
        """Advance by one tick."""
        self._driven.before_physics()
        self._driven.plant.step()
        self.after_physics()

    def after_physics(self) -> None:
        """Last part of a tick, once the world has moved."""
        self._driven.after_physics()
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
            self._slow.publish_time(self.stamp)

    def before_diagnostics(self) -> None:
        """Report what the drivers do."""
        if self.active:
            self.message = "paused" if self.paused else self._driven.state
            servo = self._driven.servo
            self.values["driver timeouts"], self.values["set-points refused"] = str(servo.timeouts), str(servo.refused)
            self.values["silence before timeout [s]"] = f"{servo.silence:.4f}"
            self.values["starts interrupted"] = str(self._driven.interruptions)
            self.values["faults injected"] = self._driven.plant.faults.summary


def _ticks_between(rate: float, period: float) -> int:
    """Ticks of a period [s] from one sample to the next at a rate [Hz].

    Raises:
        ConfigError: They are no whole number.
    """
    ticks = round(1.0 / (rate * period))
    if ticks < 1 or abs(ticks * rate * period - 1.0) > 1e-6:  # 1e-6: rounding of the quotient
        raise ConfigError(f"sensor_rate: the tick rate {1.0 / period:.0f} Hz is no multiple of {rate:g} Hz")
    return ticks


def main(args: list[str] | None = None) -> None:
    """Run the node in a process of its own."""
    sys.exit(run([MujocoBridge], args, run_plant))


if __name__ == "__main__":
    main()
