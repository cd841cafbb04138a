"""Keys and gamepad events to velocities and deeds."""

import os
import struct
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from bridge.teleop import Gamepad, KeyLaw, TeleopConfig
from models.config import default_config
from models.errors import PoiseError
from models.robot_model import RobotModel
from planners.gait.scaling import load_gait_config

CONFIG = default_config(TeleopConfig, "bridge", "teleop")


@pytest.fixture
def law(g1: RobotModel) -> KeyLaw:
    return KeyLaw(CONFIG, load_gait_config(g1).velocity.ranges)


def test_keys_change_the_velocity_by_steps_and_space_halts(law: KeyLaw) -> None:
    assert [law.press(key, 0.0) for key in "wwqa"] == [""] * 4
    assert law.velocity(0.0) == pytest.approx((0.2, 0.05, 0.1))
    assert law.press("s", 0.0) == "" and law.velocity(0.0)[0] == pytest.approx(0.1)
    assert law.press(" ", 0.0) == "halt" and law.velocity(0.0) == (0.0, 0.0, 0.0)


def test_no_key_goes_beyond_the_limits_of_the_gait(law: KeyLaw, g1: RobotModel) -> None:
    limits = load_gait_config(g1).velocity
    for key in "wqa" * 50:
        law.press(key, 0.0)
    assert law.velocity(0.0) == pytest.approx((limits.forward, limits.lateral, limits.turn), abs=1e-3)
    for key in "sed" * 100:
        law.press(key, 0.0)
    assert law.velocity(0.0) == pytest.approx((-limits.backward, -limits.lateral, -limits.turn), abs=1e-3)


def test_without_an_operator_there_is_no_velocity(law: KeyLaw) -> None:
    law.press("w", 10.0)
    assert law.velocity(10.0 + CONFIG.idle)[0] > 0.0
    assert law.velocity(10.1 + CONFIG.idle) == (0.0, 0.0, 0.0)
    law.press("y", 20.0)  # means nothing, and does not bring the old velocity back
    assert law.velocity(20.0) == (0.0, 0.0, 0.0)


def test_the_velocity_of_one_who_went_away_does_not_come_back_with_a_key(law: KeyLaw) -> None:
    law.press("w", 10.0)
    law.press("w", 10.0)
    law.press("w", 11.0 + CONFIG.idle)  # the velocity has not been read since
    assert law.velocity(11.0 + CONFIG.idle) == pytest.approx((0.1, 0.0, 0.0))


def test_keys_that_act_at_once_halt_first(law: KeyLaw) -> None:
    law.press("w", 0.0)
    assert law.press("n", 0.0) == "stand" and law.velocity(0.0) == (0.0, 0.0, 0.0)


def event(kind: int, number: int, value: int) -> bytes:
    return struct.pack("<IhBB", 0, value, kind, number)


def test_a_gamepad_gives_parts_of_the_limits_and_deeds(tmp_path: Path) -> None:
    device = tmp_path / "js0"
    os.mkfifo(device)
    limits = {"forward": (-0.4, 0.9), "left": (-0.3, 0.3), "turn": (-0.8, 0.8)}
    pad = Gamepad(device, CONFIG.gamepad, limits)
    hand = os.open(device, os.O_WRONLY)
    assert pad.read() == [] and pad.velocity() == (0.0, 0.0, 0.0)
    os.write(hand, event(0x82, 1, -32767) + event(0x82, 3, 0))  # the first stick is found deflected
    assert pad.read() == [] and pad.velocity() == (0.0, 0.0, 0.0)
    os.write(hand, event(0x02, 1, 0) + event(0x02, 1, -32767) + event(0x02, 3, 16384) + event(0x02, 0, 1000))
    assert pad.read() == []
    assert pad.velocity() == pytest.approx((0.9, 0.0, -0.4), abs=1e-3)  # left is inside the dead band
    held = event(0x81, 1, 1)  # was down when the device was opened: it is not pressed now
    os.write(hand, held + event(0x02, 1, 32767) + event(0x01, 6, 1) + event(0x01, 0, 1) + event(0x01, 0, 0)[:3])
    assert pad.read() == ["E-STOP", "walk"]
    assert pad.velocity()[0] == pytest.approx(-0.4)
    os.write(hand, event(0x01, 0, 0)[3:])  # the rest of an event that was cut
    assert pad.read() == []
    os.close(hand)
    pad.close()


def test_a_missing_gamepad_is_named(tmp_path: Path) -> None:
    with pytest.raises(PoiseError, match="js7: cannot be opened as a gamepad: No such file"):
        Gamepad(tmp_path / "js7", CONFIG.gamepad, {})


def test_a_device_without_events_is_no_gamepad() -> None:
    pad = Gamepad(Path(os.devnull), CONFIG.gamepad, {})
    with pytest.raises(PoiseError, match="/dev/null: end of file: not a gamepad"):
        pad.read()
    pad.close()
