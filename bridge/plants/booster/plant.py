"""A Booster humanoid by its low-level protocol: the robot as the driver program sees it."""

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
    """LowState in, LowCmd out; the robot executes LowCmds in its mode ``custom``, which is the release of its vendor.

    It changes to that mode only with a LowCmd at hand: damping commands are sent from the request on. ``close`` leaves
    the robot in its own damping.

    Args:
        model: The robot, with a section ``hardware`` in its profile.
        network_interface: Of this computer, to the robot; only named in messages, see ``bridge/launch/hardware.py``.
        domain: DDS domain of the robot.
        marker: File that marks an unfinished run; that of the interface when empty.
        link: Connection to the robot; one over DDS when None.
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
        self._imu_error = np.zeros(3)  # mean of the accelerometer without gravity [m/s^2]
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
                f"accelerometer: {np.linalg.norm(accel):.1f} m/s^2, {error:.1f} m/s^2 off gravity at the estimated "
                f"orientation"
            )
        return found

    @property
    def holds(self) -> tuple[str, ...]:
        """Holds of the monitors, and a remote controller whose connection is lost."""
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
        """Request mode ``custom``, with a damping command, for which the guard does not stand in."""
        self._link.send(self._encode_command(damping_command(self._model), last=True))
        self._link.release()

    def _finish(self) -> None:
        self._end_guard()  # also where the robot's own controller is active: the guard would go on against it
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
