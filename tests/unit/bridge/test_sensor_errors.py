"""Sensor errors from a file or a line of YAML."""

from pathlib import Path

import numpy as np
import pytest

from bridge.plants.sensors import read_sensor_errors
from models.errors import ConfigError, JointNameError
from models.robot_model import RobotModel


def test_file_and_line_say_the_same(g1: RobotModel, tmp_path: Path) -> None:
    text = "{gyro_bias: [0.05, 0, 0], encoder_offsets: {left_knee_joint: 0.03}, force_offsets: 15}"
    file = tmp_path / "errors.yaml"
    file.write_text(text)
    for errors in (read_sensor_errors(text), read_sensor_errors(str(file))):
        assert errors is not None
        np.testing.assert_array_equal(errors.array("gyro_bias", (3,)), [0.05, 0.0, 0.0])
        np.testing.assert_array_equal(errors.array("force_offsets", (2, 3)), 15.0)
        assert errors.offsets(g1)[g1.joint_index("left_knee_joint")] == 0.03
    assert read_sensor_errors(" ") is None


@pytest.mark.parametrize(
    ("text", "culprit"),
    [
        ("{gyro: 1}", "unknown key 'gyro'"),
        ("{gyro_bias: [1, 2]}", "gyro_bias"),
        ("{gyro_bias: many}", "gyro_bias"),
        ("{encoder_offsets: {left_knee_joint: many}}", "left_knee_joint"),
        ("{encoder_offsets: {tail_joint: 0.1}}", "tail_joint"),
        ("{gyro_bias: [1, 2", "not valid YAML"),
        ("/nowhere/errors.yaml", "cannot be read"),
    ],
)
def test_what_is_wrong_is_named(g1: RobotModel, text: str, culprit: str) -> None:
    with pytest.raises((ConfigError, JointNameError), match=culprit.replace("[", r"\[")):
        errors = read_sensor_errors(text)
        assert errors is not None
        errors.array("gyro_bias", (3,))
        errors.offsets(g1)
