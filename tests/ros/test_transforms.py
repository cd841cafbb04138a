"""The static transforms and the links of the robot form one tree."""

import numpy as np
import pytest

from controllers.nodes.estimate_topics import static_frames
from models.robot_model import RobotModel

pytestmark = pytest.mark.ros


def test_the_static_frames_make_one_tree_with_the_links(robot: RobotModel) -> None:
    """Every frame has one parent, and ``robot_state_publisher`` brings the links."""
    frames = static_frames(robot)
    children = [child for _, child, _ in frames]
    assert len(set(children)) == len(children)
    links = {frame.name for frame in robot.pin.frames if frame.type.name == "BODY"}
    root = robot.profile.base_link
    assert {parent for parent, _, _ in frames} <= links | {"base_link"}
    assert set(children) & links <= {root}
    assert {"l_sole", "r_sole", "imu", "torso", "gaze"} <= set(children) | links
    assert root == "base_link" or ("base_link", root) in {(parent, child) for parent, child, _ in frames}
    for _, child, where in frames:
        if child in ("l_sole", "r_sole"):
            sole = robot.profile.feet.left if child == "l_sole" else robot.profile.feet.right
            np.testing.assert_allclose(where[:3], sole.xyz, atol=1e-12)
