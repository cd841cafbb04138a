"""The hand-over between the standing law and the walker."""

from __future__ import annotations

from typing import Any

import pytest

from controllers.law_switch import LawSwitch
from controllers.walker import Walker
from models.applied import Applied, TickNote
from models.types import Mode


class Named(str):
    """A reference that is only a name."""

    posture = ""


class Law:
    """Notes what it is asked."""

    def __init__(self, name: str, calls: list[str]) -> None:
        self._name, self._calls = name, calls
        self.settled = False
        self.reference: Any = Named(f"reference of {name}")
        self.motion_active = False

    def follow(self, trajectory: Any) -> None:
        self._calls.append(f"{self._name} follows {trajectory}")

    def stop_motion(self) -> None:
        self._calls.append(f"{self._name} stops")

    def reset(self, state: Any) -> None:
        self._calls.append(f"{self._name} from {state}")

    def step(self, state: Any, *rest: Any) -> Any:
        self._calls.append(f"{self._name} {state}")
        return self._name


class Arms:
    """Notes the motions that a walker is asked for, and moves nothing."""

    def __init__(self, calls: list[str]) -> None:
        self._calls = calls
        self.active = False

    def follow(self, trajectory: Any, posture: Any) -> None:
        self._calls.append(f"arms {trajectory} from {posture}")
        self.active = True

    def stop(self) -> None:
        self._calls.append("arms stop")

    def drop(self) -> None:
        self.active = False

    def step(self, reference: Any, dt: float) -> Any:
        return reference


class Robot:
    """A switch between two laws, and what they were asked."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.gait = Law("gait", self.calls)
        tracker = Law("tracker", self.calls)
        walker: Any = Walker(self.gait, tracker, Arms(self.calls))  # type: ignore[type-var, arg-type]
        self.applied = Applied()
        self.laws = LawSwitch(Law("stand", self.calls), lambda: walker, applied=self.applied)

    def run(self, mode: Mode, state: Any) -> list[str]:
        """Enter a mode and tick once; what was asked meanwhile."""
        self.calls.clear()
        self.laws.enter(mode, state)
        self.laws.step(state, 0.001)
        return list(self.calls)


@pytest.fixture
def robot() -> Robot:
    return Robot()


def test_the_walker_takes_over_from_the_state_at_hand_and_gives_it_back(robot: Robot) -> None:
    assert robot.run(Mode.STAND, 1) == ["stand 1"]
    assert robot.run(Mode.WALK, 2) == ["gait from 2", "tracker from 2", "gait 2", "tracker 2"]
    assert robot.laws.reference == "reference of tracker"
    assert robot.run(Mode.WALK, 3) == ["gait 3", "tracker 3"]  # it goes on
    assert robot.run(Mode.STAND, 4) == ["stand from 4", "stand 4"]
    assert robot.laws.reference == "reference of stand"
    assert robot.run(Mode.MOTION, 5) == ["stand 5"]
    assert robot.run(Mode.WALK, 6)[0] == "gait from 6"  # every walk begins anew


def test_what_a_replay_has_to_know_is_noted(robot: Robot) -> None:
    robot.laws.reset(0)
    for mode in (Mode.STAND, Mode.WALK, Mode.WALK, Mode.DAMP, Mode.STAND):
        robot.run(mode, 1)
    robot.laws.stop_motion()
    told = TickNote.read(robot.applied.take(1)).before
    assert told == (("reset",), ("walk", True, "walk"), ("walk", False, "damp"), ("stop_motion",))


def test_the_gait_is_active_until_it_has_settled(robot: Robot) -> None:
    robot.gait.settled = True
    assert not robot.laws.gait_active
    robot.gait.settled = False
    assert not robot.laws.gait_active  # nobody walks
    robot.run(Mode.WALK, 1)
    assert robot.laws.gait_active
    robot.gait.settled = True
    assert not robot.laws.gait_active


def test_a_walk_that_ends_damped_is_not_taken_up_again(robot: Robot) -> None:
    robot.run(Mode.WALK, 1)
    robot.calls.clear()
    robot.laws.enter(Mode.DAMP, 2)
    assert robot.calls == []
    robot.laws.reset(3)
    assert robot.run(Mode.STAND, 3) == ["stand 3"]


def test_without_a_gait_planner_the_standing_law_goes_on() -> None:
    calls: list[str] = []
    laws = LawSwitch(Law("stand", calls), None)  # type: ignore[arg-type]
    laws.enter(Mode.WALK, 1)  # type: ignore[arg-type]
    laws.step(1, 0.001)  # type: ignore[arg-type]
    assert calls == ["stand 1"]
    assert not laws.walking and not laws.gait_active and not laws.can_walk


def test_a_motion_is_the_business_of_the_law_that_runs(robot: Robot) -> None:
    robot.run(Mode.STAND, 1)
    robot.laws.follow("squat")  # type: ignore[arg-type]
    robot.laws.stop_motion()
    assert robot.calls[-2:] == ["stand follows squat", "stand stops"]
    robot.run(Mode.WALK, 2)
    assert not robot.laws.motion_active
    robot.laws.active.reference.posture = "posture of the walk"
    robot.laws.follow("wave")  # type: ignore[arg-type]
    assert robot.laws.motion_active
    robot.laws.stop_motion()
    assert robot.calls[-2:] == ["arms wave from posture of the walk", "arms stop"]
    robot.run(Mode.STAND, 3)
    assert not robot.laws.motion_active
    robot.run(Mode.WALK, 4)
    assert not robot.laws.motion_active  # a new walk begins without
