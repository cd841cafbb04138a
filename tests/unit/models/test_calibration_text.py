"""The answers of the calibration services survive the way through a line of text."""

import numpy as np
import pytest

from models.calibration import Calibration
from models.nodes.calibration_text import calibration_to_reply, reply_to_text, text_to_reply
from models.robot_model import RobotModel
from models.types import CommandReply


def test_reason_and_numbers_come_back() -> None:
    reply = CommandReply(True, "gyro bias of 0.05 rad/s; x = y", {"gyro_bias_x": 0.0500123, "samples": 2000.0})
    assert text_to_reply(True, reply_to_text(reply)) == reply
    assert text_to_reply(False, "refused: it moves") == CommandReply(False, "refused: it moves")
    assert text_to_reply(True, "").reason == "done"


def test_a_calibration_is_shown_with_what_it_corrects(g1: RobotModel) -> None:
    calibration = Calibration.none(g1)
    calibration.encoder_offsets[3] = 0.02
    calibration.wrench_offsets[1, 2] = -15.0
    np.copyto(calibration.gyro_bias, [0.0, 0.05, 0.0])
    reply = calibration_to_reply(calibration, g1, "in the file")
    assert reply.accepted and reply.reason == "never calibrated; in the file"
    assert reply.details[f"{g1.joint_names[3]} [rad]"] == 0.02
    assert reply.details["right_fz [N]"] == -15.0 and reply.details["gyro_bias_y [rad/s]"] == 0.05
    assert [name for name in reply.details if name.endswith("_joint [rad]")] == [f"{g1.joint_names[3]} [rad]"]
    assert text_to_reply(True, reply_to_text(reply)).details == pytest.approx(reply.details)
