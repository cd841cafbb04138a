"""Replies of the calibration services as text: the reason, then one line ``name = number`` per detail."""

from __future__ import annotations

from typing import TYPE_CHECKING

from models.constants import FOOT_NAMES
from models.types import CommandReply

if TYPE_CHECKING:
    from models.calibration import Calibration
    from models.robot_model import RobotModel

_CHANNELS = ("fx", "fy", "fz", "tx", "ty", "tz")


def reply_to_text(reply: CommandReply) -> str:
    """Text for the ``message`` of a std_srvs/Trigger; inverse of ``text_to_reply``."""
    return "\n".join([reply.reason, *(f"{name} = {value:.9g}" for name, value in reply.details.items())])


def text_to_reply(accepted: bool, text: str) -> CommandReply:
    """Parse the text of a reply; lines that are not a detail belong to the reason."""
    reason, details = [], {}
    for line in text.splitlines():
        name, separator, value = line.partition(" = ")
        try:
            details[name] = float(value if separator else "no number")
        except ValueError:
            reason.append(line)
    return CommandReply(accepted, "\n".join(reason) or "done", details)


def calibration_to_reply(calibration: Calibration, model: RobotModel, remark: str) -> CommandReply:
    """Reply with the numbers of a calibration, named with units; encoder offsets only where nonzero."""
    details = {f"gyro_bias_{axis} [rad/s]": float(x) for axis, x in zip("xyz", calibration.gyro_bias, strict=True)}
    details |= {f"accel_bias_{axis} [m/s^2]": float(x) for axis, x in zip("xyz", calibration.accel_bias, strict=True)}
    for name, offset in zip(model.joint_names, calibration.encoder_offsets, strict=True):
        if offset:
            details[f"{name} [rad]"] = float(offset)
    for foot, row, gain in zip(FOOT_NAMES, calibration.wrench_offsets, calibration.force_gains, strict=True):
        for channel, value in zip(_CHANNELS, row, strict=True):
            details[f"{foot}_{channel} [{'N' if channel[0] == 'f' else 'N.m'}]"] = float(value)
        details[f"{foot}_gain [-]"] = float(gain)
    stamps = ", ".join(f"{what} of {stamp}" for what, stamp in calibration.stamps)
    return CommandReply(True, f"{stamps or 'never calibrated'}; {remark}", details)
