"""Units of the numbers that a calibration tells."""

from __future__ import annotations

import re

UNITS = {
    r"time(_\w+)?": "s",
    r"joint_speed|gyro_spread|gyro_drift|(turning|gyro_bias)_[xyz]": "rad/s",
    r"accel_norm|accel_spread|accel_bias_[xyz]": "m/s^2",
    r"joint_drift|tilt|disagreement|sigma_\w+": "rad",
    r"load|weight|load_spread|load_error|force_spread|(left|right)_f[xyz]": "N",
    r"(left|right)_t[xyz]": "N.m",
    r"singular_(max|min)": "1/rad",
}
"""Unit by pattern of a name."""

PLAIN = r"(samples|windows|joints)(_\w+)?|residual|shift|gravity_[xyz]|(left|right)_gain"
"""Pattern of the names of counts, ratios and directions."""


def name_and_unit(text: str) -> tuple[str, str]:
    """Name and unit of a number; the unit is empty for counts and ratios.

    Args:
        text: Such as ``accel_norm``, or with its unit, ``gyro_bias_x [rad/s]``; what is not known otherwise is the
            offset of a joint.
    """
    name, bracket, unit = text.partition(" [")
    if bracket:
        told = unit.removesuffix("]")
        return name, "" if told == "-" else told
    if re.fullmatch(PLAIN, name):
        return name, ""
    return name, next((unit for pattern, unit in UNITS.items() if re.fullmatch(pattern, name)), "rad")
