"""Policies in ONNX files: what the network gets, what the drives get, and what is refused."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from benchmarks.core import contender
from benchmarks.core.contender import ContenderLoop
from benchmarks.core.provenance import configuration
from benchmarks.stability import standing_policy
from models.constants import GRAVITY
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import SensorData, Vector

pytest.importorskip("onnxruntime")
onnx = pytest.importorskip("onnx")

JOINTS = {
    "right_knee": {"default": 0.4, "kp": 90.0, "kd": 3.0, "scale": 0.5},
    "left_knee_joint": {"default": 0.5, "kp": 100.0, "kd": 4.0},
}


def policy(folder: Path, inputs: int, first: int, outputs: int = 2, **described: Any) -> contender.Contender:
    """One whose action is the part of its input from ``first`` on."""
    weights = [np.zeros((inputs, 4)), np.zeros(4), np.zeros((4, outputs)), np.zeros(outputs)]
    model = standing_policy.network(weights)
    del model.graph.node[:]
    names = ["starts", "ends"]
    bounds = [onnx.helper.make_tensor(n, onnx.TensorProto.INT64, [2], v)
              for n, v in zip(names, ([0, first], [1, first + outputs]), strict=True)]  # fmt: skip
    del model.graph.initializer[:]
    model.graph.initializer.extend(bounds)
    model.graph.node.append(onnx.helper.make_node("Slice", ["observation", *names], ["action"]))
    (folder / "slice.onnx").write_bytes(model.SerializeToString())
    file = folder / "slice.yaml"
    file.write_text(
        yaml.safe_dump({"model": "slice.onnx", "rate": 50.0, "joints": JOINTS} | described, sort_keys=False)
    )
    return contender.load(str(file))


def sample(model: RobotModel, t: float = 0.0, **values: Vector) -> SensorData:
    zero = np.zeros(model.nj)
    given = {"q": zero, "v": zero, "gyro": np.zeros(3), "accel": np.array((0.0, 0.0, GRAVITY))} | values
    return SensorData(t=t, tau=zero, wrenches=np.zeros((2, 6)), **given)


def targets(made: contender.Contender, model: RobotModel, sensors: SensorData) -> Vector:
    """Action of one tick, from the targets of the joints: right knee, left knee."""
    command = made.step(sensors, 0.001)
    right, left = (model.joint_index(name) for name in JOINTS)
    return np.array(((command.q[right] - 0.4) / 0.5, command.q[left] - 0.5))


def test_gains_and_targets_are_the_policys_and_other_joints_stand(g1: RobotModel, tmp_path: Path) -> None:
    made = policy(tmp_path, 3, 0, observations=[{"term": "command", "scale": [2.0, 1.0, 1.0]}])
    made.reset(g1, 0)
    made.set_velocity(0.1, -0.3, 0.0)
    command, right = made.step(sample(g1), 0.001), g1.joint_index("right_knee")
    assert command.q[right] == pytest.approx(0.4 + 0.5 * 0.2) and command.kp is not None and command.kd is not None
    assert (command.kp[right], command.kd[right]) == (90.0, 3.0)
    others = [i for i in range(g1.nj) if i not in (right, g1.joint_index("left_knee"))]
    np.testing.assert_array_equal(command.q[others], g1.posture("stand")[others])
    np.testing.assert_array_equal(command.kp[others], g1.kp[others])
    assert not command.tau.any() and not made.torque_controlled


def test_it_runs_at_its_rate(g1: RobotModel, tmp_path: Path) -> None:
    made = policy(tmp_path, 3, 0, observations=[{"term": "command"}])
    made.reset(g1, 0)
    changes = []
    for tick in range(100):
        made.set_velocity(0.001 * tick, 0.0, 0.0)
        changes.append(targets(made, g1, sample(g1, 0.001 * tick))[0])
    assert [tick for tick in range(1, 100) if changes[tick] != changes[tick - 1]] == [20, 40, 60, 80]


@pytest.mark.parametrize(
    ("terms", "first", "expected"),
    [
        (["projected_gravity"], 0, (0.0, -np.sin(0.1))),  # rolled to the right by 0.1 rad
        (["base_angular_velocity"], 0, (0.1, 0.0)),
        (["joint_positions"], 0, (0.2, -0.5)),
        (["joint_velocities"], 0, (1.0, 0.0)),
        (["command", "phase"], 3, (0.0, 1.0)),
        (["command", "previous_action"], 3, (0.0, 0.0)),
    ],
)
def test_the_network_gets_the_terms(
    g1: RobotModel, tmp_path: Path, terms: list[str], first: int, expected: tuple[float, float]
) -> None:
    sizes = {"joint_positions": 2, "joint_velocities": 2, "phase": 2, "previous_action": 2}
    observations = [{"term": term} for term in terms]
    made = policy(tmp_path, sum(sizes.get(term, 3) for term in terms), first, observations=observations)
    made.reset(g1, 0)
    right = g1.joint_index("right_knee")
    q, v = np.zeros((2, g1.nj))
    q[right], v[right] = 0.6, 1.0
    accel = GRAVITY * np.array((0.0, np.sin(0.1), np.cos(0.1)))
    gyro = np.array((0.1, 0.0, 0.0))
    np.testing.assert_allclose(targets(made, g1, sample(g1, q=q, v=v, accel=accel, gyro=gyro)), expected, atol=1e-6)


@pytest.mark.parametrize(("stacked", "first"), [("terms", 2), ("samples", 1)])
def test_a_history_is_stacked_by_term_or_by_sample(g1: RobotModel, tmp_path: Path, stacked: str, first: int) -> None:
    """Joint positions and velocities of the left knee, three samples of each, the oldest first."""
    observations = [{"term": term, "joints": ["left_knee_joint"]} for term in ("joint_positions", "joint_velocities")]
    made = policy(tmp_path, 6, first, observations=observations, history=3, stacked=stacked)
    made.reset(g1, 0)
    left = g1.joint_index("left_knee")
    for tick in range(41):
        q, v = np.zeros((2, g1.nj))
        q[left], v[left] = 0.5 + 0.001 * tick, 1.0 + tick
        found = targets(made, g1, sample(g1, 0.001 * tick, q=q, v=v))
    # positions 0, 0.02, 0.04, velocities 1, 21, 41, at ticks 0, 20, 40
    assert found == pytest.approx((0.04, 1.0) if stacked == "terms" else (1.0, 0.02))


@pytest.mark.parametrize(
    ("described", "message"),
    [
        ({"observations": [{"term": "command"}], "speed": 1.0}, "speed: Unexpected keyword"),
        ({"observations": [{"term": "lidar"}]}, "observations.0.term: Input should be 'base_angular_velocity'"),
        ({"observations": [{"term": "command", "scale": [1.0]}]}, "command: 1 scales for 3 values"),
        ({"observations": [{"term": "command"}], "acts": ["left_hip"]}, "'left_hip' is not in joints"),
        ({"observations": [{"term": "command"}], "model": "none.onnx"}, "none.onnx cannot be loaded"),
        ({"observations": [{"term": "phase"}]}, r"input 'observation' \[1, 3\]; \[1, 2\] expected: .* phase 2"),
        ({"observations": [{"term": "command"}], "acts": ["right_knee"]}, r"output 'action' \[1, 2\]; \[1, 1\] exp"),
    ],
)
def test_what_does_not_fit_is_named(tmp_path: Path, described: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as refused:
        policy(tmp_path, 3, 0, **described)
    assert "slice.yaml" in str(refused.value)


def test_an_unknown_joint_is_named(g1: RobotModel, tmp_path: Path) -> None:
    wheel = {"left_wheel": {"default": 0.0, "kp": 1.0, "kd": 0.1}}
    made = policy(tmp_path, 3, 0, 1, observations=[{"term": "command"}], joints=wheel)
    with pytest.raises(ConfigError, match=r"slice.yaml: joints: g1: unknown joint 'left_wheel'"):
        made.reset(g1, 0)


def test_without_onnxruntime_the_remedy_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ConfigError, match=r"needs onnxruntime: pip install 'poise\[policies\]'"):
        policy(tmp_path, 3, 0, observations=[{"term": "command"}])


def test_another_model_makes_other_cases(g1: RobotModel, tmp_path: Path) -> None:
    policy(tmp_path, 3, 0, observations=[{"term": "command"}])
    name = str(tmp_path / "slice.yaml")
    before = configuration("g1", name)
    assert configuration("g1", name) == before
    policy(tmp_path, 3, 1, observations=[{"term": "command"}])
    assert configuration("g1", name) != before


def test_a_policy_made_here_stands_and_takes_a_small_push(g1: RobotModel, tmp_path: Path) -> None:
    file = standing_policy.make(g1, tmp_path / "policy")
    loop = ContenderLoop(str(file), g1, seed=8)
    loop.run(0.5)
    loop.apply_push((0.12 * g1.mass / 0.1, 0.0, 0.0), duration=0.1)
    loop.run(2.0)
    assert not loop.fallen, loop.fall_reason
    assert np.linalg.norm(loop.truth.v[:2]) < 0.05
