r"""Small standing policy as a template for contenders, fitted in a second and written as ONNX.

The network has one hidden tanh layer with random weights. The output layer is fitted by ridge regression over random
tilts and rates to

.. math::
    q^* = q_0 + k^{-1} (\tau_0 + J^T m), \quad m = \tfrac{1}{2} m_r g z\, (c - c_0) (\theta + \dot\theta / \omega)

where ``tau_0`` are the static torques of standing, ``theta`` the tilt of the base (roll, pitch) and ``J`` the Jacobian
of the soles with respect to the ankles. With the stiffness of the ankles, ``c_0``, the centre of pressure moves by
``c`` times the DCM of a pendulum of height ``z``.

    python -m benchmarks.stability.standing_policy out/policy --robot g1
    poise bench push --contender out/policy/standing.yaml
"""

import argparse
import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from models.constants import GRAVITY
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import Matrix

STIFFNESS = 1.5  #: ``c_0``: stiffness of both ankles over the toppling stiffness of the pendulum [-]
DCM_GAIN = 2.2  #: ``c`` [-]
DAMPING_TIME = 0.05  #: Damping over stiffness of the leg joints [s]
RATE = 100.0  #: Rate of the policy [Hz]
SCALE = 0.25  #: Offset of the targets per unit of action [rad]
HIDDEN, SAMPLES, RIDGE = 64, 4096, 1e-6  #: Hidden units and samples [-]; weight of the regularisation [-]
TILT, TURN = 0.2, 1.0  #: Standard deviations of the sampled tilts [rad] and rates [rad/s]


class StandingLaw:
    """Law that the network approximates."""

    def __init__(self, model: RobotModel) -> None:
        q, data = model.standing_configuration(), model.data()
        weight, height = model.mass * GRAVITY, float(pin.centerOfMass(model.pin, data, q)[2])
        pin.computeJointJacobians(model.pin, data, q)
        pin.updateFramePlacements(model.pin, data)
        self.posture, self.kp, self.kd = q[7:].copy(), model.kp.copy(), model.kd.copy()
        ankles = np.zeros((2, model.nj))
        for foot in model.feet:
            leg = np.array(foot.joint_ids_v) - 6
            self.kp[leg] = 0.5 * STIFFNESS * weight * height
            self.kd[leg] = DAMPING_TIME * self.kp[leg]
            jacobian = pin.getFrameJacobian(model.pin, data, foot.frame_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            ankles[:, leg[-2:]] = jacobian[3:5, 6 + leg[-2:]]
        self._torques = model.static_torques(q, model.data())
        self._gain = 0.5 * weight * height * (DCM_GAIN - STIFFNESS) * ankles  # (2, nj)
        self._omega = math.sqrt(GRAVITY / height)

    def targets(self, rates: Matrix, gravity: Matrix) -> Matrix:
        """Return offsets of the targets (n, nj) [rad] from rates and gravity directions in the base frame (n, 3)."""
        tilt = np.column_stack((-gravity[:, 1], gravity[:, 0]))
        result: Matrix = (self._torques + (tilt + rates[:, :2] / self._omega) @ self._gain) / self.kp
        return result


def fit(law: StandingLaw, rng: np.random.Generator) -> tuple[list[Matrix], float]:
    """Return the weights of both layers (w, b, w, b), and the RMS error of the targets at other samples [rad]."""

    def draw() -> tuple[Matrix, Matrix]:
        tilt = rng.normal(0.0, TILT, (SAMPLES, 2))
        gravity = np.column_stack((np.sin(tilt), -np.sqrt(np.maximum(1.0 - (np.sin(tilt) ** 2).sum(axis=1), 0.0))))
        rates = rng.normal(0.0, TURN, (SAMPLES, 3))
        return np.column_stack((rates, gravity)), law.targets(rates, gravity) / SCALE

    hidden, offset = rng.normal(0.0, 0.3, (6, HIDDEN)), rng.normal(0.0, 0.3, HIDDEN)

    def features(inputs: Matrix) -> Matrix:
        return np.column_stack((np.tanh(inputs @ hidden + offset), np.ones(len(inputs))))

    inputs, actions = draw()
    rows = features(inputs)
    out = np.linalg.solve(rows.T @ rows / SAMPLES + RIDGE * np.eye(HIDDEN + 1), rows.T @ actions / SAMPLES)
    inputs, actions = draw()
    error = float(np.sqrt(np.mean((features(inputs) @ out - actions) ** 2))) * SCALE
    return [hidden, offset, out[:-1], out[-1]], error


def network(weights: list[Matrix]) -> Any:
    """Return the ONNX model of a tanh layer and a linear layer; ``ConfigError`` without ``onnx``."""
    try:
        from onnx import TensorProto, helper, numpy_helper
    except ImportError as error:
        raise ConfigError("making a policy needs onnx: pip install 'poise[policies]'") from error
    names = ["w1", "b1", "w2", "b2"]
    values = [numpy_helper.from_array(x.astype(np.float32), name) for x, name in zip(weights, names, strict=True)]
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, size])
        for name, size in (("observation", len(weights[0])), ("action", len(weights[3])))
    ]
    nodes = [
        helper.make_node("Gemm", ["observation", "w1", "b1"], ["sum"]),
        helper.make_node("Tanh", ["sum"], ["features"]),
        helper.make_node("Gemm", ["features", "w2", "b2"], ["action"]),
    ]
    graph = helper.make_graph(nodes, "standing", ends[:1], ends[1:], values)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def make(model: RobotModel, folder: Path, seed: int = 0) -> Path:
    """Fit the policy of a robot, write its model and its YAML file; returns the YAML file."""
    law = StandingLaw(model)
    weights, error = fit(law, np.random.default_rng(seed))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "standing.onnx").write_bytes(network(weights).SerializeToString())
    gains = zip(model.joint_names, law.posture, law.kp, law.kd, strict=True)
    described = {
        "model": "standing.onnx",
        "rate": RATE,
        "observations": [{"term": "base_angular_velocity"}, {"term": "projected_gravity"}],
        "joints": {
            name: {"default": round(float(q), 4), "kp": round(float(kp), 2), "kd": round(float(kd), 3), "scale": SCALE}
            for name, q, kp, kd in gains
        },
    }
    file = folder / "standing.yaml"
    title = f"# Standing policy of {model.name}; the fit is within {error:.1e} rad (RMS). Units: docs/contenders.md\n"
    file.write_text(title + yaml.safe_dump(described, sort_keys=False, default_flow_style=None, width=120))
    return file


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Make a standing policy")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robot", default="g1")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    print(make(RobotModel.load(arguments.robot), arguments.folder, arguments.seed))
