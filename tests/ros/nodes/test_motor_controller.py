"""``motor_controller``: the torques of the simulated drivers, their refusals, and no jerk whatever is commanded."""

from typing import Any

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from controllers.joints.joint_servo import JointServo
from controllers.nodes.motor_controller import MotorControllerNode
from models.errors import JointNameError, MessageError
from models.nodes import topics
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import JointCommandCodec, JointStateCodec, TorqueCodec, decode, trajectory_to_message
from models.nodes.qos import COMMAND, LATCHED
from models.robot_model import RobotModel
from models.types import JointCommand, JointTrajectory
from tests.ros.delivery import deliver
from tests.servos import torque_of

pytestmark = pytest.mark.ros

MS = 1_000_000


class Motors:
    """The node, and what its motors were commanded."""

    def __init__(self, bench: Any, model: RobotModel, **parameters: object) -> None:
        self.bench, self.model, self.stamp = bench, model, 100 * MS
        given = {"sensor_timeout": 10.0, "diagnostics_period": 10.0, **parameters}
        self.node = bench.add(MotorControllerNode, robot=model.name, **given)
        self.torques: list[np.ndarray] = []
        self.states: list[str] = []
        self._joints, self._commands = JointStateCodec(model), JointCommandCodec(model)
        publish = self.node._motors.publish

        def tap(data: bytes) -> None:
            self.torques.append(TorqueCodec(model).decode(data)[1])
            publish(data)

        self.node._motors.publish = tap
        self.q, self.v = model.posture("stand"), np.zeros(model.nj)

    def arm(self) -> None:
        for word in ("damp", "stand"):
            deliver(self.node, topics.MODE, String(data=word))

    def tick(self, q: np.ndarray | None = None, v: np.ndarray | None = None, *, ahead: int = MS) -> None:
        self.stamp += ahead
        data = self._joints.encode(self.stamp, self.q if q is None else q, self.v if v is None else v, self.v)
        deliver(self.node, topics.JOINT_STATES, data)

    def command(self, q: np.ndarray, *, tau: float = 0.0, stamp: int | None = None) -> None:
        command = JointCommand(q, np.zeros(self.model.nj), np.full(self.model.nj, tau))
        deliver(
            self.node, topics.JOINT_SETPOINTS, self._commands.encode(self.stamp if stamp is None else stamp, command)
        )

    @property
    def last_refusal(self) -> str:
        return str(self.node.values.get("last refusal", ""))


def test_the_torques_are_those_of_the_simulated_drivers(bench: Any, robot: RobotModel) -> None:
    """Armed, commanded, silent, damped: bit by bit what ``JointServo`` gives the plant."""
    motors, servo = Motors(bench, robot), JointServo(robot)
    rng = np.random.default_rng(0)
    servo.damp()
    motors.arm()
    servo.arm()
    expected = []
    for k in range(500):
        q, v = motors.q + 0.01 * rng.normal(size=robot.nj), 0.1 * rng.normal(size=robot.nj)
        motors.tick(q, v)
        expected.append(torque_of(servo, motors.stamp / NANOSECONDS, q, v, 0.0 if k == 0 else 0.001).copy())
        if 10 <= k < 400:
            setpoint = motors.q + 0.02 * rng.normal(size=robot.nj)
            motors.command(setpoint, tau=1.0)
            zero = np.zeros(robot.nj)
            assert servo.command(JointCommand(setpoint, zero, zero + 1.0), motors.stamp / NANOSECONDS)
    np.testing.assert_array_equal(motors.torques, expected)
    assert servo.timeouts == motors.node.law.servo.timeouts == 1


def test_nothing_that_is_commanded_jerks(bench: Any, g1: RobotModel) -> None:
    """Setpoints from end to end of the joints, noise, lost samples, trajectories, modes: the torque rate holds."""
    motors = Motors(bench, g1)
    motors.arm()
    rng = np.random.default_rng(1)
    largest = g1.tau_rate_max * motors.node._config.step_max * (1.0 + 1e-9)
    for k in range(2000):
        q = g1.q_lower + rng.uniform(-0.1, 1.1, g1.nj) * (g1.q_upper - g1.q_lower)
        motors.tick(q, 20.0 * rng.normal(size=g1.nj), ahead=MS * int(rng.choice([1, 2, 7, 30])))
        motors.command(rng.uniform(-10.0, 10.0, g1.nj), tau=float(rng.uniform(-1e4, 1e4)))
        if k % 100 == 50:
            deliver(motors.node, topics.MODE, String(data=str(rng.choice(["damp", "stand", "walk", "off"]))))
    torques = np.array(motors.torques)
    assert np.abs(torques).max() > 50.0
    assert (np.abs(torques) <= g1.tau_max).all()
    assert (np.abs(np.diff(torques, axis=0, prepend=0.0)) <= largest).all()


def test_the_first_command_is_faded_in(bench: Any, g1: RobotModel) -> None:
    motors = Motors(bench, g1)
    motors.arm()
    motors.tick()
    away = np.clip(motors.q + 0.3, g1.q_lower, g1.q_upper)
    for _ in range(30):
        motors.tick()
        motors.command(away)
    share = 0.03 / motors.node.law.servo.config.arming_blend
    assert np.abs(motors.torques[-1]).max() < 3.0 * share**2 * 0.3 * g1.kp.max()


def test_stale_and_wrong_commands_are_refused(bench: Any, g1: RobotModel) -> None:
    motors = Motors(bench, g1)
    motors.arm()
    motors.tick()
    motors.command(motors.q)
    for _ in range(30):
        motors.tick()
    motors.command(motors.q, stamp=motors.stamp - 21 * MS)
    assert "more than 20000000 ns" in motors.last_refusal
    assert motors.node.counters["commands too old"] == 1
    motors.command(motors.q, stamp=motors.stamp + MS)
    assert "is in the future" in motors.last_refusal
    motors.command(motors.q)
    motors.command(motors.q)
    assert "is not after" in motors.last_refusal
    motors.tick()
    motors.command(np.full(g1.nj, np.nan))
    assert "is nan" in motors.last_refusal
    jump = JointTrajectory(g1.joint_names, np.array([0.001]), motors.q[None].copy(), None, None)
    jump.positions[0, g1.joint_index("left_knee_joint")] += 0.5
    before = motors.node.law.servo.setpoint.q
    deliver(motors.node, topics.JOINT_SETPOINTS, serialize_message(trajectory_to_message(jump)))
    assert "start jump" in motors.last_refusal
    np.testing.assert_array_equal(motors.node.law.servo.setpoint.q, before)


def test_wrong_samples_are_refused(bench: Any, g1: RobotModel) -> None:
    motors = Motors(bench, g1)
    motors.tick()
    motors.tick(ahead=0)
    assert "repeats" in motors.last_refusal
    motors.tick(np.full(g1.nj, np.nan))
    assert "position of" in motors.last_refusal
    motors.tick(ahead=1000 * MS)
    assert "jumps ahead" in motors.last_refusal
    assert len(motors.torques) == 1


def test_without_commands_it_damps_and_stays_so_until_it_is_armed(bench: Any, g1: RobotModel) -> None:
    motors = Motors(bench, g1)
    received: list[str] = []
    bench.world.create_subscription(String, topics.MOTOR_STATE, lambda m: received.append(m.data), LATCHED)
    bench.wait(lambda: received == ["off"])
    motors.arm()
    motors.tick()
    bench.wait(lambda: received[-1] == "active")
    motors.command(motors.q)
    for _ in range(41):
        motors.tick()
    assert motors.node.law.servo.timeouts == 1
    motors.command(motors.q)
    motors.tick()
    bench.wait(lambda: received[-1] == "damped")
    deliver(motors.node, topics.MODE, String(data="walk"))  # from stand: they have not been armed
    motors.tick()
    assert motors.node.law.servo.state.value == "damped"
    motors.arm()
    motors.tick()
    bench.wait(lambda: received[-1] == "active")


def test_silent_joints_damp(bench: Any, g1: RobotModel) -> None:
    motors = Motors(bench, g1, sensor_timeout=0.04)
    motors.arm()
    motors.tick()
    bench.wait(lambda: motors.node.counters["joint silences"] == 1)
    assert motors.node.law.servo.state.value == "damped"
    bench.spin(0.1)
    assert motors.node.counters["joint silences"] == 1


def test_a_mode_that_was_there_before_does_not_arm(bench: Any, g1: RobotModel) -> None:
    motors = Motors(bench, g1)
    deliver(motors.node, topics.MODE, String(data="stand"))
    assert "was active before the drivers started" in motors.last_refusal
    deliver(motors.node, topics.MODE, String(data="stand"))
    motors.tick()
    assert motors.node.law.servo.state.value == "off"
    deliver(motors.node, topics.MODE, String(data="fly"))
    assert "unknown mode 'fly'" in motors.last_refusal
    motors.arm()
    assert motors.node.law.servo.state.value == "active"
    deliver(motors.node, topics.MODE, String(data="off"))
    assert "request 'damp' first" in motors.last_refusal


def test_torques_over_the_graph_and_their_message(bench: Any, g1: RobotModel) -> None:
    received: list[bytes] = []
    bench.world.create_subscription(JointState, topics.MOTOR_COMMANDS, received.append, COMMAND, raw=True)
    motors = Motors(bench, g1)
    bench.wait(lambda: motors.node._motors.get_subscription_count() == 1)
    motors.arm()
    motors.tick()
    bench.wait(lambda: received)
    message, codec = decode(received[0], JointState), TorqueCodec(g1)
    assert tuple(message.name) == g1.joint_names
    assert (len(message.position), len(message.velocity), len(message.effort)) == (0, 0, g1.nj)

    message.name, message.effort = message.name[::-1], np.arange(g1.nj, dtype=float)
    np.testing.assert_array_equal(codec.decode(serialize_message(message))[1], np.arange(g1.nj)[::-1])
    message.effort = message.effort[:-1]
    with pytest.raises(MessageError, match="effort: "):
        codec.decode(serialize_message(message))
    message.name = message.name[:-1]
    with pytest.raises(JointNameError, match="is missing"):
        codec.decode(serialize_message(message))
