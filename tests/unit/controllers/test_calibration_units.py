"""Names and units of the numbers of a calibration."""

import pytest

from controllers.calibration.windows import name_and_unit


@pytest.mark.parametrize(
    ("text", "name", "unit"),
    [
        ("gyro_bias_x [rad/s]", "gyro_bias_x", "rad/s"),
        ("left_gain [-]", "left_gain", ""),
        ("left_gain", "left_gain", ""),
        ("gyro_bias_x", "gyro_bias_x", "rad/s"),
        ("gravity_z", "gravity_z", ""),
        ("accel_norm", "accel_norm", "m/s^2"),
        ("right_fz", "right_fz", "N"),
        ("right_tx", "right_tx", "N.m"),
        ("time_standing", "time_standing", "s"),
        ("samples_unusable", "samples_unusable", ""),
        ("singular_min", "singular_min", "1/rad"),
        ("sigma_left_knee_joint", "sigma_left_knee_joint", "rad"),
        ("left_knee_joint", "left_knee_joint", "rad"),
    ],
)
def test_every_number_has_its_unit(text: str, name: str, unit: str) -> None:
    assert name_and_unit(text) == (name, unit)
