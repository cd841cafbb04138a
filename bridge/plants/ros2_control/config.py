"""Schema of ``bridge/config/ros2_control.yaml``: names of controllers and topics, and how the robot is commanded."""

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Positive, default_config, overlaid
from models.profile import Thresholds
from models.robot_model import RobotModel

Source = Literal["joint_states", "imu", "left_foot", "right_foot", "command"]  #: What a controller gives or takes
JOINTS: Final = "joint_states"
IMU: Final = "imu"
FEET: Final[tuple[Source, Source]] = ("left_foot", "right_foot")
COMMAND: Final = "command"
STATE: Final = "state"
#: Topic of each source below the name of its controller, where it is not in the namespace of the controller manager
_LOCAL: Mapping[Source, str] = {IMU: "imu", FEET[0]: "wrench", FEET[1]: "wrench", COMMAND: "commands"}


@dataclass(frozen=True, slots=True, config=STRICT)
class Ros2ControlConfig:
    """Options of the plant."""

    command: Literal["effort", "pvt", "feedback"]  #: What the command controller takes
    rate: Annotated[float, Field(ge=100.0, le=2000.0)]  #: Update rate of the controller manager [Hz]
    part_age_max: Positive  #: Age up to which a sample of IMU or foot is used with newer joints [s]
    #: Age of the newest message of a source, against the joint states, beyond which the robot is damped [s]
    silent_max: Positive
    state_age_max: Positive  #: Only with command effort: time without a state from which on the torque has no gains [s]
    imu_distance_max: Positive  #: Distance of the measured point from the profile's frame ``imu`` [m]
    foreign_commands: Thresholds  #: Commands of other programs within a second [Hz]
    #: Of the controller manager and its controllers, before every name that does not begin with a slash
    namespace: Annotated[str, Field(pattern=r"^(/?[A-Za-z_][A-Za-z0-9_]*)*$")]
    controller_manager: str  #: Its name; empty: the states of the controllers are not checked
    #: Name of the controller by source: joint_state_broadcaster/JointStateBroadcaster,
    #: imu_sensor_broadcaster/IMUSensorBroadcaster, force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster of each
    #: foot, and the one that executes the commands
    controllers: dict[Source, str]
    #: Topic by source, empty for the one that the controller has by default; ``state``, only with command feedback, is
    #: linear_feedback_controller_msgs/Sensor
    topics: dict[Source | Literal["state"], str]
    delay: Annotated[
        float, Field(ge=0.001, le=0.02)
    ]  #: Only with command effort: expected from a state to its torque [s]
    #: Only with command effort: multiple of ``delay`` up to which the gains of the driver are stable [-]
    delay_margin: Annotated[float, Field(ge=1.0, le=5.0)]
    free_flyer: bool  #: Only with command feedback: whether the controller's state includes the base

    @property
    def topic_of(self) -> dict[str, str]:
        """Topic by source, ``command`` and ``state`` included."""
        names: dict[Source | Literal["state"], str] = {JOINTS: JOINTS, STATE: "sensor"}
        names |= {source: f"{self.controllers[source]}/{local}" for source, local in _LOCAL.items()}
        if self.command == "feedback":
            names[COMMAND] = "control"
        return {source: self.full_name(self.topics[source] or name) for source, name in names.items()}

    @property
    def manager(self) -> str:
        """Full name of the controller manager; empty: it is not asked."""
        return self.controller_manager and self.full_name(self.controller_manager)

    def full_name(self, name: str) -> str:
        """A name in the namespace of the controller manager."""
        return name if name.startswith("/") else "/" + "/".join(filter(None, [self.namespace.strip("/"), name]))


def read_config(options: Mapping[str, Any]) -> Ros2ControlConfig:
    """The packaged options with others in their place, by nested keys; ``ConfigError`` names every wrong key."""
    return overlaid(default_config(Ros2ControlConfig, "bridge", "ros2_control"), options, "plant ros2_control")


def sources(model: RobotModel) -> tuple[Source, ...]:
    """Sources of a robot's sensor data: joints, IMU, and the feet where they have sensors."""
    return (JOINTS, IMU, *(FEET if model.profile.sensors.feet.fitted else ()))
