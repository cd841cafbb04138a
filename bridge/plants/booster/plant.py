"""Plant of a Booster humanoid with its low-level protocol."""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from bridge.plants.booster.codec import BUTTONS, BoosterCodec, BoosterSample, RemoteController, Stamped, read_config
from bridge.plants.booster.link import BoosterLink, DdsBoosterLink
from bridge.plants.hardware import RobotClock, real_robot
from bridge.plants.low_level import LowLevelPlant
from controllers.joints.joint_servo import damping_command
from models.constants import GRAVITY, NANOSECONDS
from models.robot_model import RobotModel
from models.types import JointCommand


class BoosterPlant(LowLevelPlant[BoosterSample]):
    """LowState in, LowCmd out. In mode ``custom`` the vendor's controller is released and the robot executes LowCmds.

    The robot enters this mode only if it receives LowCmds, so each request is sent with a damping command. ``close``
    leaves the robot in its mode ``damping``.

    Args:
        model: The robot, with a section ``hardware`` in its profile.
        network_interface: This computer's interface to the robot; only for messages, see ``bridge/launch/hardware.py``.
        domain: DDS domain of the robot.
        marker: File that marks an unfinished run; empty for the default of interface and domain.
        link: Connection to the robot; over DDS when None.
        options: Values that replace those of ``bridge/config/booster.yaml``.

    Raises:
        ConfigError: A robot with other joints, with foot sensors or without ``hardware``, or a wrong option.
    """

    guard_process = "bridge.plants.booster.guard:connect"
    _link: BoosterLink
    state_name = "low_state"
    own_controller = "Booster's controller"
    service_name = "the robot's service LocoApi"

    def __init__(
        self,
        model: RobotModel,
        network_interface: str = "lo",
        domain: int = 0,
        marker: str = "",
        link: BoosterLink | None = None,
        **options: Any,
    ) -> None:
        self._config = config = read_config(options)
        tick = 1.0 / NANOSECONDS if config.clock == "stamp" else 1.0 / config.rate
        clock = RobotClock(1.0 / config.rate, real_robot().gap_max, tick, 1 << 63)
        super().__init__(model, "booster", (network_interface, domain), marker, 1.0 / config.rate, clock, BUTTONS)
        self._codec = BoosterCodec(model, config, clock, self._session)
        self._imu_error = np.zeros(3)  # mean acceleration without gravity [m/s^2]
        self._remote = RemoteController(config.remote_age_max, config.remote_event_age_max)
        self._end_warning = ""
        self._link = DdsBoosterLink(domain, config.mode_period) if link is None else link

    def _decode(self, message: Stamped) -> BoosterSample | None:
        if message.state:
            return self._codec.decode(message)
        self._pressed |= self._remote.receive(message.data)
        return None

    def _accept(self, sample: BoosterSample) -> None:
        super()._accept(sample)
        self._remote.step(self._period)
        self._remote.served = self._link.remote_served
        roll, pitch, _ = sample.rpy
        up = np.array([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])
        share = min(self._period / self._config.imu_window, 1.0)
        self._imu_error += share * (sample.sensors.accel - GRAVITY * up - self._imu_error)

    def _checks(self, sample: BoosterSample) -> list[str]:
        error, accel, found = float(np.linalg.norm(self._imu_error)), sample.sensors.accel, list[str]()
        if self._remote.fault:
            found.append(self._remote.fault)
        if error > self._config.imu_error:
            found.append(
                f"accelerometer: {np.linalg.norm(accel):.1f} m/s^2, {error:.1f} m/s^2 from gravity at the estimated "
                f"orientation"
            )
        return found

    @property
    def holds(self) -> tuple[str, ...]:
        """As ``LowLevelPlant``, and a fault of the remote controller's connection."""
        return (*super().holds, *filter(None, [self._remote.fault]))

    def _is_foreign(self, data: bytes) -> bool:
        return self._codec.is_foreign(data)

    def _encode_command(self, command: JointCommand, *, last: bool = False) -> bytes:
        return self._codec.encode(command, last)

    def _decode_command(self, data: bytes) -> JointCommand:
        return self._codec.decode_command(data)

    @property
    def report(self) -> Mapping[str, str]:
        """Values of the monitors, counts of states, and the age of the newest message of the remote controller."""
        return {**super().report, "remote controller silent for [s]": f"{self._remote.age:.1f}"}

    @property
    def remote_age(self) -> float | None:
        return self._remote.age

    @property
    def end_warning(self) -> str:
        return self._end_warning

    def release_vendor(self) -> None:
        """Send a damping command that does not arm the guard, and request mode ``custom``."""
        self._link.send(self._encode_command(damping_command(self._model), last=True))
        self._link.release()

    def _finish(self) -> None:
        self._end_guard()  # also if the vendor's controller is active, because the guard would command against it
        data, period = self._encode_command(damping_command(self._model), last=True), real_robot().command_period
        for _ in range(round(self._config.finish_time / period)):
            if self.vendor:
                return
            self._link.send(data)
            self._link.damp()
            time.sleep(period)
        if not self.vendor:
            mode = "an unknown mode" if self.vendor is None else "mode custom"
            self._end_warning = (
                f"the robot is still in {mode} after {self._config.finish_time:g} s and executes the last damping "
                f"command: change its mode by its remote controller"
            )
