"""The graph drives a robot behind ros2_control over ROS 2, in real time: a stand-in written from the documentation.

Times are the robot's, which waits while this machine is busy; no time of this machine is asserted.
"""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from benchmarks.graph.robot_session import HardwareSession
from bridge.driver.probes import ANSWER_VALUES
from bridge.ros.environment import free_domain
from models.errors import MessageError
from models.nodes.interfaces import interface

pytestmark = [pytest.mark.ros, pytest.mark.graph, pytest.mark.slow]


@contextmanager
def session_of(folder: Path, robot: str, options: str, speed: float) -> Iterator[HardwareSession]:
    """A robot and its graph; skipped where the types are not built."""
    try:
        interface("controller_manager_msgs", "srv", "ListControllers")
        interface("control_msgs", "msg", "DynamicInterfaceGroupValues")
        interface("linear_feedback_controller_msgs", "msg", "Control")
    except MessageError as error:
        pytest.skip(str(error))
    with HardwareSession(
        "rclpy", folder, robot, options, speed, graph_domain=free_domain(), robot_domain=free_domain(), rate=None,
        plant="ros2_control", robot=robot, plant_options=options, module="tests.ros2_control.process",
    ) as session:  # fmt: skip
        yield session


@pytest.mark.parametrize(
    ("robot", "command", "velocity"),
    [("g1", "effort", 0.4), ("talos", "effort", 0.3), ("g1", "pvt", 0.4), ("g1", "feedback", 0.4)],
)
def test_it_stands_waves_and_walks(tmp_path: Path, robot: str, command: str, velocity: float) -> None:
    """By default at half speed: two busy cores do not carry robot and graph in real time.

    ``POISE_ROS2_CONTROL_STAND`` and ``_WALK`` change the times [s], ``_SPEED`` the robot's speed.
    """
    given = {"STAND": "5", "WALK": "6", "SPEED": "0.5"}
    stand, walk, speed = (float(os.environ.get(f"POISE_ROS2_CONTROL_{name}", usual)) for name, usual in given.items())
    with session_of(tmp_path, robot, f"{{command: {command}}}", speed) as session:
        session.stand()
        session.robot("clear")
        assert np.abs(session.drift(stand)).max() < 0.01
        session.send("wave")
        session.pass_time(1.0)
        walked, estimated = session.walk(velocity, walk, 1.0)
        print({"walked": walked, "odometry": estimated, **session.robot("report")})
        print({key: session.value(key) for key in ANSWER_VALUES.values()})
        assert session.graph.standing
        assert walked[0] > 0.6 * velocity * walk and np.linalg.norm(estimated - walked) < 0.05 + 0.01 * walked[0]


def test_the_guard_damps_for_a_killed_driver_and_an_inactive_controller_is_named(tmp_path: Path) -> None:
    with session_of(tmp_path, "g1", "{command: effort}", 0.5) as session:
        session.stand()
        graph = session.graph
        session.robot("controller", "imu_sensor_broadcaster", "inactive")
        graph.wait_for(lambda: graph.driver_state == "damped", 20.0, "damped")
        session.wait_for(lambda: "imu_sensor_broadcaster" in session.waits_for, "reported")
        session.robot("controller", "imu_sensor_broadcaster", "active")
        received = session.robot("report")["received"]
        os.kill(graph.pids["bridge.nodes.robot_driver"], signal.SIGKILL)
        graph.wait_for(lambda: session.robot("report")["received"] > received + 100, 20.0, "damping by the guard")
        graph.wait_for(lambda: "start it again" in session.waits_for, 60.0, "the next driver")
        accepted, answer = graph.call("start/prepare")
        assert not accepted and "start it again" in answer
        graph.stop()
        assert not np.any(session.robot("torque"))
        assert set(graph.exit_codes.values()) == {0}
