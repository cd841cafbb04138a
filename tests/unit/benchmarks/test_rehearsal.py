"""``poise rehearse``: what its words do to the simulated robot."""

from typing import Any

import pytest

from benchmarks import rehearsal
from benchmarks.rehearsal import ACTS, HELP, act


class Robot:
    """Notes the calls; its base is where ``report`` says."""

    def __init__(self) -> None:
        self.calls: list[tuple[object, ...]] = []

    def __call__(self, *call: object) -> Any:
        self.calls.append(call)
        seen = {"base": [0.0, 0.1, 0.8], "load": 320.0, "kp": 0.0, "kd": 2.0, "received": 5, "refused": 0}
        return seen if call == ("report",) else True


def test_every_word_is_explained_and_shows_the_state(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "PRESS_TIME", 0.0)
    for word in ACTS:
        robot = Robot()
        assert word in HELP and "(0.00, 0.10, 0.80) m, load on the feet 320 N" in act(robot, word)
        assert robot.calls[-1] == ("report",) and (len(robot.calls) > 1 or word == "show")


def test_a_button_is_released_and_a_push_has_its_impulse(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "PRESS_TIME", 0.0)
    robot = Robot()
    act(robot, "press")
    assert robot.calls[:2] == [("press", 9), ("press",)]
    robot.calls.clear()
    act(robot, "push")
    _, *force, duration = robot.calls[0]
    assert [each * duration for each in force] == pytest.approx([0.0, 12.0, 0.0])


def test_an_unknown_word_names_the_known_ones() -> None:
    robot = Robot()
    assert act(robot, "fly").startswith("unknown command 'fly'; known:") and not robot.calls
