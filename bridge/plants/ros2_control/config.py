"""Schema of ``bridge/config/ros2_control.yaml``: controllers, topics and kind of command."""

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Positive, default_config, overlaid
from models.profile import Thresholds
from models.robot_model import RobotModel

Source = Literal["joint_states", "imu", "left_foot", "right_foot", "command"]  #: Input or output of a controller
JOINTS: Final = "joint_states"
IMU: Final = "imu"
FEET: Final[tuple[Source, Source]] = ("left_foot", "right_foot")
COMMAND: Final = "command"
STATE: Final = "state"
#: Topic of each source, relative to the name of its controller; other topics are relative to the namespace
_LOCAL: Mapping[Source, str] = {IMU: "imu", FEET[0]: "wrench", FEET[1]: "wrench", COMMAND: "commands"}


@dataclass(frozen=True, slots=True, config=STRICT)
class Ros2ControlConfig:
    """Options of the plant."""

    command: Literal["effort", "pvt", "feedback"]  #: Kind of command that the command controller accepts
    rate: Annotated[float, Field(ge=100.0, le=2000.0)]  #: Update rate of the controller manager [Hz]
    part_age_max: Positive  #: Largest age of an IMU or foot sample that is combined with newer joint states [s]
    #: Age of the newest message of a source, relative to the joint states, above which the robot is damped [s]
    silent_max: Positive
    state_age_max: Positive  #: Only with command effort: time without a state after which gains are zero [s]
    imu_distance_max: Positive  #: Largest distance of the measured point from the profile's frame ``imu`` [m]
    foreign_commands: Thresholds  #: Rate of the commands of other programs over a second [Hz]
    #: Namespace of the controller manager and its controllers; prefix of all names without a leading slash
    namespace: Annotated[str, Field(pattern=r"^(/?[A-Za-z_][A-Za-z0-9_]*)*$")]
    controller_manager: str  #: Name of the controller manager; empty: the states of the controllers are not checked
    #: Name of the controller by source: joint_state_broadcaster/JointStateBroadcaster,
    #: imu_sensor_broadcaster/IMUSensorBroadcaster, force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster of each
    #: foot, and the command controller
    controllers: dict[Source, str]
    #: Topic by source, empty for the controller's default; ``state`` (linear_feedback_controller_msgs/Sensor) is only
    #: for command feedback
    topics: dict[Source | Literal["state"], str]
    delay: Annotated[
        float, Field(ge=0.001, le=0.02)
    ]  #: Only with command effort: expected delay from a state to its torque [s]
    #: Only with command effort: multiple of ``delay`` up to which the PD loop is stable [-]
    delay_margin: Annotated[float, Field(ge=1.0, le=5.0)]
    free_flyer: bool  #: Only with command feedback: whether the controller's state includes the base

    @property
    def topic_of(self) -> dict[str, str]:
        """Full topic name by source, including ``command`` and ``state``."""
        names: dict[Source | Literal["state"], str] = {JOINTS: JOINTS, STATE: "sensor"}
        names |= {source: f"{self.controllers[source]}/{local}" for source, local in _LOCAL.items()}
        if self.command == "feedback":
            names[COMMAND] = "control"
        return {source: self.full_name(self.topics[source] or name) for source, name in names.items()}

    @property
    def manager(self) -> str:
        """Full name of the controller manager; empty when it is not used."""
        return self.controller_manager and self.full_name(self.controller_manager)

    def full_name(self, name: str) -> str:
        """A name in the namespace of the controller manager."""
        return name if name.startswith("/") else "/" + "/".join(filter(None, [self.namespace.strip("/"), name]))


def read_config(options: Mapping[str, Any]) -> Ros2ControlConfig:
    """The packaged options, overlaid by given ones with nested keys; ``ConfigError`` names every wrong key."""
    return overlaid(default_config(Ros2ControlConfig, "bridge", "ros2_control"), options, "plant ros2_control")


def sources(model: RobotModel) -> tuple[Source, ...]:
    """Sources of a robot's sensor data: joints, IMU, and feet with sensors."""
    return (JOINTS, IMU, *(FEET if model.profile.sensors.feet.fitted else ()))
