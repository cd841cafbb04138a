"""The state estimator in the closed loop: its error against the true state while the robot moves and is pushed."""

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.stability.estimate import PARTS, ErrorLog, interval, nees
from bridge.closed_loop import ClosedLoop


def errors(loop: ClosedLoop, duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Error of base velocity in B (n, 3) [m/s], roll and pitch (n, 2) [rad], height (n,) [m]."""
    speed, tilt, height = [], [], []
    for _ in range(round(duration / loop.plant.period)):
        truth = loop.truth  # of the instant that this tick's sensors measure
        loop.step()
        state = loop.state
        assert state.t == pytest.approx(truth.t, abs=1e-9)
        speed.append(state.v[:3] - truth.v[:3])
        turn = pin.Quaternion(state.q[3:7]).matrix() @ pin.Quaternion(truth.q[3:7]).matrix().T
        tilt.append(pin.log3(turn)[:2])
        height.append(state.q[2] - truth.q[2])
    return np.array(speed), np.array(tilt), np.array(height)


def rms(x: np.ndarray) -> float:
    return float(np.sqrt((x**2).mean(axis=0)).max())


@pytest.mark.parametrize("robot", ["g1", "talos"])
def test_errors_while_squatting_and_pushed(robot: str) -> None:
    loop = ClosedLoop(robot, seed=3, record=False)
    impulse = 0.2 * loop.robot.mass  # [N.s]: 0.2 m/s
    assert loop.command("squat").accepted
    parts = [errors(loop, 0.8)]
    loop.apply_push((0.8 * impulse / 0.1, 0.6 * impulse / 0.1, 0.0), duration=0.1)
    parts.append(errors(loop, 1.0))
    speed, tilt, height = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    assert not loop.fallen
    assert rms(speed) < 0.005
    assert np.abs(speed).max() < 0.02
    assert np.degrees(rms(tilt)) < 0.5
    assert np.abs(height).max() < 0.005
    assert all(contact.active for contact in loop.state.contacts)


@pytest.mark.long
def test_covariance_is_honest_and_knows_more_about_yaw_never() -> None:
    """Standing, then pushed, over independent runs: errors as large as the covariance says, within 99.9 %."""
    loop, seeds = ClosedLoop("g1", record=False), range(5)
    values: dict[str, list[float]] = {part: [] for part in PARTS}
    for seed in seeds:
        loop.reset(seed)
        log = ErrorLog(loop, 0.05)
        log.run(0.4)
        loop.apply_push((0.2 * loop.robot.mass / 0.1, 0.0, 0.0), duration=0.1)
        log.run(0.6)
        errors, covariances = np.array(log.errors), np.array(log.covariances)
        for part, rows in PARTS.items():
            values[part].append(float(nees(errors, covariances, rows).mean()))
        yaw = covariances[:, 5, 5]
        assert (np.diff(yaw) >= -1e-9 * yaw[0]).all()
    for part, rows in PARTS.items():
        assert np.mean(values[part]) < interval(rows.size, len(seeds), 0.999)[1]
        assert np.mean(values[part]) > 0.25 * rows.size  # and not by being timid
