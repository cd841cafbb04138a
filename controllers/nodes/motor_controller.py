"""Node ``motor_controller``: joint states and joint commands in, torques for the motors of a real robot out."""

import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from controllers.joints.joint_servo import JointServoConfig, ServoState
from controllers.joints.motor_driver import MotorDriver, MotorDriverConfig
from models.config import default_config
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import JointCommandCodec, JointStateCodec, TorqueCodec, mode_named
from models.nodes.parameters import declare_config
from models.nodes.qos import COMMAND, LATCHED, SENSOR
from models.nodes.spin import program

WATCH_PERIOD = 0.01  #: Time between two checks for silent joints [s]


class MotorControllerNode(PoiseNode):
    """Runs ``MotorDriver`` once per sample of ``joint_states``.

    ``robot_driver`` contains these drivers, too, so this node publishes the state on a separate topic; without
    ``robot_driver``, remap it to ``driver_state``. Without samples nothing is published: motors must damp by themselves
    when ``motor_commands`` is silent.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("motor_controller", **kwargs)
        self._config = declare_config(self, default_config(MotorDriverConfig, "controllers", "motor_driver"))
        self._servo = declare_config(self, default_config(JointServoConfig, "controllers", "joint_servo"), "servo.")
        self._sampled = 0.0
        self._published = ""
        self.every(WATCH_PERIOD, self._watch)

    def configure(self) -> None:
        self._joints, self._commands = JointStateCodec(self.model), JointCommandCodec(self.model)
        self._torques = TorqueCodec(self.model)
        self._motors = self.announce(JointState, topics.MOTOR_COMMANDS, COMMAND)
        self._state = self.announce(String, topics.MOTOR_STATE, LATCHED)
        self.listen(JointState, topics.JOINT_STATES, self._on_joints, SENSOR, raw=True, while_active=True)
        self.listen(JointTrajectory, topics.JOINT_SETPOINTS, self._on_command, COMMAND, raw=True, while_active=True)
        self.listen(String, topics.MODE, self._on_mode, LATCHED, while_active=True)

    def activate(self) -> None:
        """Begin without torque."""
        self.law = MotorDriver(self.model, self._config, self._servo, self.counters)
        self._published = ""

    def _on_joints(self, data: bytes) -> None:
        stamp, q, v, _ = self._joints.decode(data)
        tau = self.law.sample(stamp, q, v)
        self._sampled = time.monotonic()
        self._motors.publish(self._torques.encode(stamp, tau))
        self._publish_state()

    def _on_command(self, data: bytes) -> None:
        self.law.command(*self._commands.decode(data))

    def _on_mode(self, message: String) -> None:
        self.law.set_mode(mode_named(message.data))
        self._publish_state()

    def _watch(self) -> None:
        if not self.active:
            return
        if time.monotonic() - self._sampled > self._config.sensor_timeout and self.law.damp_on_silence():
            self.alarm()
        self._publish_state()

    def _publish_state(self) -> None:
        state = self.law.servo.state.value
        if self._published != state:
            self._published = state
            self._state.publish(String(data=state))

    def before_diagnostics(self) -> None:
        if not self.active:
            return
        servo = self.law.servo
        self.level = DiagnosticStatus.ERROR if servo.state is ServoState.DAMPED else DiagnosticStatus.OK
        self.message = servo.state.value
        self.values["driver timeouts"], self.values["setpoints refused"] = str(servo.timeouts), str(servo.refused)
        self.values["samples not finite"] = str(servo.sensor_faults)


main = program(MotorControllerNode)


if __name__ == "__main__":
    main()
