"""Coefficient of friction from soles that slide and soles that hold."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.estimation.config import EstimatorConfig, expecting
from controllers.estimation.friction import FrictionEstimator, friction_demand, watch_friction
from models.config import default_config
from models.constants import GRAVITY
from models.errors import ConfigError
from models.robot_model import RobotModel

DT = 0.001
ROTATIONS = np.tile(np.eye(3), (2, 1, 1))
CONFIG = default_config(EstimatorConfig, "controllers", "estimator").friction


def sole_wrench(model: RobotModel, ratio: float) -> np.ndarray:
    """The whole weight on the middle of the sole, pulled by a share of it (6,)."""
    x_min, x_max, y_min, y_max = model.feet[0].rectangle
    weight, x, y = model.mass * GRAVITY, 0.5 * (x_min + x_max), 0.5 * (y_min + y_max)
    return weight * np.array([ratio, 0.0, 1.0, y, -x, -y * ratio])


def rotation(pitch: float) -> np.ndarray:
    """About y (3, 3)."""
    c, s = np.cos(pitch), np.sin(pitch)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


class Ground:
    """The left sole bears the weight and slides against the ground's force, or holds; the right one is in the air."""

    def __init__(self, model: RobotModel, **changed: float) -> None:
        self.model, self.law = model, FrictionEstimator(model, replace(CONFIG, **changed), GRAVITY)
        self.soles, self.pitch = np.zeros((2, 2)), 0.0

    def run(
        self, ratio: float, duration: float, *, speed: float = 0.0, flat: float = 1.0, angle: float = 0.0,
        turning: float = 0.0,
    ) -> float:  # fmt: skip
        """Coefficient after ``duration`` [s].

        ``angle`` [rad] is between the velocity and the way against the force, ``turning`` the rate of pitch [rad/s].
        """
        wrenches, slips = np.array([sole_wrench(self.model, ratio), np.zeros(6)]), np.array([float(speed > 0.0), 0.0])
        for _ in range(round(duration / DT)):
            self.soles[0] -= speed * DT * np.array([np.cos(angle), np.sin(angle)])
            self.pitch += turning * DT
            rotations = ROTATIONS if self.pitch == 0.0 else np.stack([rotation(self.pitch), np.eye(3)])
            watch_friction(wrenches, np.array([flat, 0.0]), slips, self.soles, rotations, DT, self.law.memory)
        return float(self.law.coefficient[0])


@pytest.fixture
def ground(g1: RobotModel) -> Ground:
    return Ground(g1)


def test_the_start_is_the_expected_coefficient(g1: RobotModel, ground: Ground) -> None:
    assert ground.law.coefficient[0] == g1.profile.feet.friction
    assert Ground(g1, expected=0.3).law.coefficient[0] == 0.3
    assert expecting(0.3).friction.expected == 0.3 and expecting(None).friction == CONFIG
    with pytest.raises(ConfigError, match="expected_friction"):
        expecting(-0.1)


def test_a_sole_that_slides_shows_the_coefficient(ground: Ground) -> None:
    assert ground.run(0.25, 0.2, speed=0.1) == pytest.approx(0.25, abs=0.01)


def test_a_sole_that_holds_raises_it_slowly_and_to_no_more_than_the_nominal_one(g1: RobotModel, ground: Ground) -> None:
    slippery = ground.run(0.2, 0.2, speed=0.1)
    assert ground.run(0.05, 5.0) == pytest.approx(slippery, abs=1e-3)  # it shows nothing: it would hold on any ground
    after = ground.run(0.2, 1.0)
    assert slippery + 0.01 < after < 0.25
    assert ground.run(0.7, 100.0) == g1.profile.feet.friction


@pytest.mark.parametrize(("speed", "flat"), [(0.01, 1.0), (1.0, 0.0)])
def test_slow_motion_and_tipping_are_no_slides(ground: Ground, speed: float, flat: float) -> None:
    before = ground.law.coefficient[0]
    assert ground.run(0.2, 0.5, speed=speed, flat=flat) == before


@pytest.mark.parametrize("angle", [1.0, np.pi])
def test_a_sole_that_moves_along_the_force_or_across_does_not_slide(ground: Ground, angle: float) -> None:
    before = ground.law.coefficient[0]
    assert ground.run(0.2, 0.5, speed=0.1, angle=angle) == before


def test_a_sole_that_turns_over_an_edge_does_not_slide(ground: Ground) -> None:
    before = ground.law.coefficient[0]
    assert ground.run(0.2, 0.1, speed=0.15, turning=3.0) == before
    assert ground.run(0.2, 0.01, speed=0.15) == before  # the filter follows with a delay
    assert ground.run(0.2, 0.3, speed=0.15) == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize(("speed", "turning"), [(0.1, 0.2), (0.5, 2.0)])
def test_a_sole_that_moves_faster_than_its_turning_slides(ground: Ground, speed: float, turning: float) -> None:
    assert ground.run(0.25, 0.3, speed=speed, turning=turning) == pytest.approx(0.25, abs=0.01)


def test_a_new_start_forgets_what_turned(ground: Ground) -> None:
    ground.run(0.2, 0.1, turning=5.0)
    ground.pitch = 0.0
    ground.law.reset()
    assert ground.run(0.25, 0.2, speed=0.1) == pytest.approx(0.25, abs=0.01)


def test_the_force_turns_with_the_sole(ground: Ground, monkeypatch: pytest.MonkeyPatch) -> None:
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    monkeypatch.setattr(f"{__name__}.ROTATIONS", np.tile(quarter, (2, 1, 1)))
    before = ground.law.coefficient[0]
    assert ground.run(0.2, 0.2, speed=0.1) == before
    assert ground.run(0.2, 0.2, speed=0.1, angle=0.5 * np.pi) == pytest.approx(0.2, abs=0.01)


def test_turning_needs_friction_too(g1: RobotModel) -> None:
    rectangle, wrench = np.array(g1.feet[0].rectangle), sole_wrench(g1, 0.0)
    assert friction_demand(wrench, rectangle) == pytest.approx(0.0)
    assert friction_demand(sole_wrench(g1, 0.3), rectangle) == pytest.approx(0.3)
    lever = 0.5 * np.hypot(rectangle[1] - rectangle[0], rectangle[3] - rectangle[2])  # of every corner
    wrench[5] = 0.2 * lever * wrench[2]
    assert friction_demand(wrench, rectangle) == pytest.approx(0.2)
