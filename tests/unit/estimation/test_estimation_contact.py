"""Contact detection: hysteresis, delay, centre of pressure, and the noise that follows."""

import numpy as np
import pytest

from controllers.estimation.config import EstimatorConfig
from controllers.estimation.feet import ContactDetector
from models.config import default_config, parse_config, read_yaml
from models.errors import ConfigError
from models.robot_model import RobotModel

DT = 0.001
CONFIG = default_config(EstimatorConfig, "controllers", "estimator")


@pytest.fixture
def detector(g1: RobotModel) -> ContactDetector:
    return ContactDetector(g1, CONFIG.contact, CONFIG.foot_sensors, CONFIG.foot, CONFIG.gravity)


SOUND, UNKNOWN = np.zeros(2), np.full(2, -1.0)


def update(detector: ContactDetector, sample: np.ndarray, fault: np.ndarray = SOUND,
           expected: np.ndarray = UNKNOWN, samples: np.ndarray = SOUND) -> None:  # fmt: skip
    detector.update(sample, samples, fault, expected, DT)


def wrenches(g1: RobotModel, left: float, right: float, cop: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Vertical loads as shares of the weight, both with the same centre of pressure."""
    result = np.zeros((2, 6))
    result[:, 2] = np.array([left, right]) * g1.mass * CONFIG.gravity
    result[:, 3] = cop[1] * result[:, 2]
    result[:, 4] = -cop[0] * result[:, 2]
    return result


def test_between_the_thresholds_nothing_changes(g1: RobotModel, detector: ContactDetector) -> None:
    middle = 0.5 * (CONFIG.contact.load_on + CONFIG.contact.load_off)
    detector.reset(wrenches(g1, 0.5, 0.0), SOUND)
    for _ in range(100):
        update(detector, wrenches(g1, middle, middle))
    assert detector.active.tolist() == [1.0, 0.0]


def test_noise_across_one_threshold_does_not_chatter(g1: RobotModel, detector: ContactDetector) -> None:
    rng = np.random.default_rng(0)
    detector.reset(wrenches(g1, 0.5, 0.5), SOUND)
    changes = 0
    for _ in range(2000):
        before = detector.active.copy()
        load = CONFIG.contact.load_on + rng.normal(scale=0.2 * (CONFIG.contact.load_on - CONFIG.contact.load_off))
        update(detector, wrenches(g1, load, load))
        changes += int(np.count_nonzero(before != detector.active))
    assert changes == 0


def test_contact_is_made_after_the_delay_and_broken_at_once(g1: RobotModel, detector: ContactDetector) -> None:
    detector.reset(wrenches(g1, 0.5, 0.0), SOUND)
    needed = 0
    while not detector.active[1]:
        update(detector, wrenches(g1, 0.5, 0.5))
        needed += 1
    assert needed == pytest.approx(CONFIG.contact.on_delay / DT + 1, abs=1)
    update(detector, wrenches(g1, 0.5, 0.9 * CONFIG.contact.load_off))
    assert detector.active.tolist() == [1.0, 0.0]


def test_an_impact_shorter_than_the_delay_is_no_contact(g1: RobotModel, detector: ContactDetector) -> None:
    detector.reset(wrenches(g1, 0.5, 0.0), SOUND)
    for _ in range(50):
        update(detector, wrenches(g1, 0.5, 0.5))
        assert not detector.active[1]
        update(detector, wrenches(g1, 0.5, 0.0))


def test_loaded_feet_bear_from_the_first_sample(g1: RobotModel, detector: ContactDetector) -> None:
    detector.reset(wrenches(g1, 0.5, 0.5), SOUND)
    assert detector.active.all()


def test_centre_of_pressure_and_its_bounds(g1: RobotModel, detector: ContactDetector) -> None:
    detector.reset(wrenches(g1, 0.5, 0.5, cop=(0.03, -0.01)), SOUND)
    np.testing.assert_allclose(detector.cops, [[0.03, -0.01]] * 2, atol=1e-12)
    update(detector, wrenches(g1, 0.5, 0.5, cop=(1.0, 1.0)))
    np.testing.assert_allclose(detector.cops, [[foot.rectangle[1], foot.rectangle[3]] for foot in g1.feet])


def test_noise_of_a_foot_follows_load_and_centre_of_pressure(g1: RobotModel, detector: ContactDetector) -> None:
    x_min, x_max, y_min, y_max = g1.feet[0].rectangle
    centre = (0.5 * (x_min + x_max), 0.5 * (y_min + y_max))
    detector.reset(wrenches(g1, 0.5, 0.0, cop=centre), SOUND)
    np.testing.assert_allclose(detector.densities[0], [CONFIG.foot.slip, CONFIG.foot.flat])
    np.testing.assert_allclose(detector.densities[1], [CONFIG.foot.swing, CONFIG.foot.swing_rotation])
    update(detector, wrenches(g1, 0.5, 0.0, cop=(x_max, centre[1])))
    np.testing.assert_allclose(detector.densities[0], [CONFIG.foot.slip, CONFIG.foot.tipping])
    previous = detector.densities[0].copy()
    for share in np.linspace(CONFIG.contact.load_full, CONFIG.contact.load_off, 20)[1:]:
        update(detector, wrenches(g1, share, 0.0, cop=(x_max, centre[1])))
        assert (detector.densities[0] > previous).all()
        previous = detector.densities[0].copy()
    np.testing.assert_allclose(previous, [CONFIG.foot.swing, CONFIG.foot.swing_rotation])


def test_thresholds_in_the_wrong_order_are_refused(root: object) -> None:
    data = read_yaml(root / "controllers" / "config" / "estimator.yaml")  # type: ignore[operator]
    data["contact"]["load_off"] = 0.5
    with pytest.raises(ConfigError, match=r"contact.*load_off"):
        parse_config(EstimatorConfig, data, "test")
