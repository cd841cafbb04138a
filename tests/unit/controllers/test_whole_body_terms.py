"""Terms, tasks and the wrench cone against Pinocchio, finite differences and corner forces."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from msgspec.structs import replace

from controllers.qp.terms import Terms, frame_id_of
from controllers.whole_body.config import PointTask, WholeBodyConfig
from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.limits import CONE_ROWS, CoMHeightLimit, JointLimit, TorqueLimit, WrenchConeLimit, fill_cone
from controllers.whole_body.tasks import (
    AngularMomentumTask,
    CoMTask,
    FootTask,
    FrameOrientationTask,
    FramePositionTask,
    PostureTask,
    Task,
)
from models.config import default_config
from models.errors import ConfigError
from models.numerics.so3 import rotation_error
from models.robot_model import RobotModel
from models.types import Reference, RobotState
from tests.support import standing

ROBOTS = ("g1", "talos")

WALKING_WITH_HAND = dataclasses.replace(
    default_config(WholeBodyConfig, "controllers", "whole_body"),
    tasks={"hand": PointTask("r_wrist", 100.0, 20.0, 1000.0)},
)


@pytest.fixture(scope="module", params=ROBOTS)
def model(request: pytest.FixtureRequest) -> RobotModel:
    return RobotModel.load(request.param)


def random_state(model: RobotModel, seed: int) -> RobotState:
    rng = np.random.default_rng(seed)
    q = model.standing_configuration().copy()
    q[:3] += rng.normal(size=3)
    q[3:7] = rng.normal(size=4)
    q[3:7] /= np.linalg.norm(q[3:7])
    q[7:] += 0.3 * rng.normal(size=model.nj)
    return standing(model, q=q, v=rng.normal(size=model.nv))


def some_reference(model: RobotModel, state: RobotState) -> Reference:
    rng = np.random.default_rng(7)
    rotations = np.array([pin.exp3(rng.normal(size=3)) for _ in range(2)])
    return Reference(
        com=rng.normal(size=3),
        com_velocity=rng.normal(size=3),
        com_acceleration=rng.normal(size=3),
        base_orientation=pin.exp3(0.3 * rng.normal(size=3)),
        torso_orientation=pin.exp3(0.3 * rng.normal(size=3)),
        posture=state.q[7:] + 0.1,
        posture_velocity=rng.normal(size=model.nj),
        posture_acceleration=rng.normal(size=model.nj),
        sole_rotations=rotations,
        sole_positions=rng.normal(size=(2, 3)),
        sole_velocities=rng.normal(size=(2, 6)),
        sole_accelerations=rng.normal(size=(2, 6)),
        contacts=(False, False),
    )


@pytest.mark.parametrize("seed", range(3))
def test_terms_equal_pinocchio(model: RobotModel, seed: int) -> None:
    state = random_state(model, seed)
    terms = Terms(model, ["r_wrist", model.pin.frames[-1].name])
    terms.update(state)
    data = model.data()
    q, v = state.q, state.v
    pin.forwardKinematics(model.pin, data, q, v, np.zeros(model.nv))
    pin.updateFramePlacements(model.pin, data)
    pin.computeJointJacobians(model.pin, data, q)
    assert len(terms.frames) == 6
    for name, frame in terms.frames.items():
        frame_id = frame_id_of(model, name)
        jacobian = pin.getFrameJacobian(model.pin, data, frame_id, pin.LOCAL)
        drift = pin.getFrameClassicalAcceleration(model.pin, data, frame_id, pin.LOCAL).vector
        np.testing.assert_allclose(frame.pose, data.oMf[frame_id].homogeneous, atol=1e-12)
        np.testing.assert_allclose(frame.jacobian, jacobian, atol=1e-10)
        np.testing.assert_allclose(frame.twist, jacobian @ v, atol=1e-9)
        np.testing.assert_allclose(frame.drift, drift, atol=1e-8)
    pin.centerOfMass(model.pin, data, q, v, np.zeros(model.nv))
    np.testing.assert_allclose(terms.com, data.com[0], atol=1e-10)
    np.testing.assert_allclose(terms.com_velocity, data.vcom[0], atol=1e-10)
    np.testing.assert_allclose(terms.com_drift, data.acom[0], atol=1e-8)
    np.testing.assert_allclose(terms.com_jacobian, pin.jacobianCenterOfMass(model.pin, data, q), atol=1e-10)
    pin.dccrba(model.pin, data, q, v)
    np.testing.assert_allclose(terms.momentum_matrix, data.Ag[3:], atol=1e-9)
    np.testing.assert_allclose(terms.momentum, data.hg.angular, atol=1e-9)
    np.testing.assert_allclose(terms.momentum_drift, (data.dAg @ v)[3:], atol=1e-7)


def test_a_frame_that_there_is_not_is_refused(model: RobotModel) -> None:
    with pytest.raises(ConfigError, match=r"unknown frame 'third_hand'; known: .*URDF"):
        Terms(model, ["third_hand"])


@pytest.mark.parametrize(
    "name", ["com", "torso_orientation", "base_orientation", "left_foot", "right_foot", "posture", "hand"]
)
def test_jacobian_is_minus_the_derivative_of_the_error(model: RobotModel, name: str) -> None:
    ones, nv = np.ones(6), model.nv
    three = ones[:3], ones[:3], ones[:3]
    tasks: dict[str, Task] = {
        task.name: task
        for task in (
            CoMTask(*three, nv),
            FrameOrientationTask("torso_orientation", "torso", *three, nv, lambda ref: ref.torso_orientation),
            FrameOrientationTask("base_orientation", "base_link", *three, nv, lambda ref: ref.base_orientation),
            FramePositionTask("hand", "r_wrist", *three, nv),
            FootTask(0, ones, ones, ones, nv),
            FootTask(1, ones, ones, ones, nv),
            PostureTask(np.ones(model.nj), np.ones(model.nj), np.ones(model.nj)),
        )
    }
    task = tasks[name]
    state = random_state(model, 11)
    terms = Terms(model, task.frames)
    reference = some_reference(model, state)
    # Where the error vanishes, d(error) = -J dq exactly, for rotations too.
    terms.update(state)
    reference = Reference(
        **{
            **{field: getattr(reference, field) for field in Reference.__slots__},
            "com": terms.com.copy(),
            "base_orientation": terms.base_rotation.copy(),
            "torso_orientation": terms.torso.rotation.copy(),
            "sole_rotations": np.array([sole.rotation for sole in terms.soles]),
            "sole_positions": np.array([sole.position for sole in terms.soles]),
            "posture": state.q[7:].copy(),
        }
    )
    if isinstance(task, FramePositionTask):
        task.desired = terms.frames["r_wrist"].position.copy()
    task.update(terms, reference)
    np.testing.assert_allclose(task.error, 0.0, atol=1e-12)
    jacobian = task.jacobian.copy()
    step = 1e-6
    for column in range(model.nv):
        direction = np.zeros(model.nv)
        direction[column] = step
        errors = []
        for sign in (1.0, -1.0):
            q = pin.integrate(model.pin, state.q, sign * direction)
            terms.update(RobotState(0.0, q, state.v, state.tau, state.contacts))
            task.update(terms, reference)
            errors.append(task.error.copy())
        np.testing.assert_allclose((errors[0] - errors[1]) / (2 * step), -jacobian[:, column], atol=2e-5)


def test_momentum_task_damps(model: RobotModel) -> None:
    state = random_state(model, 2)
    terms = Terms(model)
    terms.update(state)
    task = AngularMomentumTask(np.full(3, 4.0), np.ones(3), model.nv)
    task.update(terms, some_reference(model, state))
    np.testing.assert_allclose(task.target, -4.0 * terms.momentum - terms.momentum_drift)


def test_rotation_error_at_half_turn_and_small_angles() -> None:
    out = np.zeros(3)
    for vector in ([0.0, 0.0, 0.0], [1e-8, 0.0, 0.0], [0.5, -0.2, 1.0], [np.pi, 0.0, 0.0], [0.0, 0.0, np.pi - 1e-4]):
        rotation_error(np.eye(3), pin.exp3(np.array(vector)), out)
        np.testing.assert_allclose(pin.exp3(out), pin.exp3(np.array(vector)), atol=1e-7)


RECTANGLE = (-0.05, 0.12, -0.02, 0.04)


def corner_wrench(forces: np.ndarray) -> np.ndarray:
    x_min, x_max, y_min, y_max = RECTANGLE
    corners = np.array([[x_max, y_max, 0], [x_min, y_max, 0], [x_min, y_min, 0], [x_max, y_min, 0]])
    return np.concatenate([forces.sum(axis=0), np.cross(corners, forces).sum(axis=0)])


def cone() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of the cone of ``RECTANGLE`` and their bounds."""
    matrix, lower, upper = np.empty((CONE_ROWS, 6)), np.empty(CONE_ROWS), np.empty(CONE_ROWS)
    fill_cone(np.array(RECTANGLE), 0.7, 0.0, 1e9, 1.0, matrix, lower, upper)
    return matrix, lower, upper


def test_every_sum_of_corner_forces_is_in_the_cone() -> None:
    matrix, lower, upper = cone()
    rng = np.random.default_rng(0)
    mu = 0.7 / np.sqrt(2)
    for _ in range(500):
        normal = rng.exponential(size=4)
        tangential = rng.choice([-1.0, 1.0], size=(4, 2)) * rng.uniform(size=(4, 2)) * mu * normal[:, None]
        values = matrix @ corner_wrench(np.column_stack([tangential, normal]))
        assert (values <= upper + 1e-9).all() and (values >= lower - 1e-9).all()


def test_every_wrench_in_the_cone_is_a_sum_of_corner_forces() -> None:
    from scipy.optimize import linprog

    matrix, _, upper = cone()
    mu = 0.7 / np.sqrt(2)
    rng = np.random.default_rng(1)
    maps = np.zeros((6, 12))
    for corner in range(4):
        for axis in range(3):
            forces = np.zeros((4, 3))
            forces[corner, axis] = 1.0
            maps[:, 3 * corner + axis] = corner_wrench(forces)
    pyramid = np.zeros((16, 12))
    for corner in range(4):
        for k, (axis, sign) in enumerate([(0, 1), (0, -1), (1, 1), (1, -1)]):
            pyramid[4 * corner + k, 3 * corner + axis] = sign
            pyramid[4 * corner + k, 3 * corner + 2] = -mu
    bounds = [(None, None), (None, None), (0, None)] * 4
    inside = outside = 0
    for _ in range(300):
        wrench = np.array([*rng.normal(size=2) * 0.4, 1.0, *rng.normal(size=2) * 0.04, rng.normal() * 0.03])
        answer = linprog(np.zeros(12), A_ub=pyramid, b_ub=np.zeros(16), A_eq=maps, b_eq=wrench, bounds=bounds)
        slack = (matrix @ wrench - upper).max()
        if abs(slack) < 1e-6:
            continue
        assert (slack < 0) == (answer.status == 0)
        inside += slack < 0
        outside += slack > 0
    assert inside > 20 and outside > 20


@pytest.mark.parametrize("name", ["com", "torso_orientation", "base_orientation", "left_foot", "hand"])
def test_target_is_feedback_less_drift(model: RobotModel, name: str) -> None:
    """Without feedback or feed-forward the target cancels the drift: the frame keeps its velocity."""
    controller = WholeBodyController(model, WALKING_WITH_HAND)
    state = random_state(model, 5)
    task = controller.tasks[name]
    still = np.zeros_like(task.error)
    task.kp[:], task.kd[:] = 0.0, 0.0  # type: ignore[attr-defined]  # changed in place, as by a user who tunes
    zero = replace(
        some_reference(model, state),
        com_acceleration=np.zeros(3),
        sole_accelerations=np.zeros((2, 6)),
        heading_rate=0.4,
    )
    controller.terms.update(state)
    if isinstance(task, FramePositionTask):
        task.desired = np.ones(3)
    task.update(controller.terms, zero)
    data = model.data()
    a = np.linalg.lstsq(task.jacobian, task.target, rcond=None)[0]
    pin.forwardKinematics(model.pin, data, state.q, state.v, a)
    if name == "com":
        pin.centerOfMass(model.pin, data, state.q, state.v, a)
        found = data.acom[0]
    else:
        linear, angular = slice(3), slice(3, 6)
        frame, rows = {
            "left_foot": ("l_sole", slice(6)),
            "hand": ("r_wrist", linear),
            "torso_orientation": ("torso", angular),
            "base_orientation": ("base_link", angular),
        }[name]
        found = pin.getFrameClassicalAcceleration(model.pin, data, frame_id_of(model, frame), pin.LOCAL).vector[rows]
    np.testing.assert_allclose(found, still, atol=1e-7)


@pytest.mark.parametrize("contacts", [(True, True), (True, False), (False, True), (False, False)])
def test_rows_of_every_limit_are_what_they_limit(model: RobotModel, contacts: tuple[bool, bool]) -> None:
    """Values of all rows at random points against Pinocchio, from the accelerations and wrenches of these points."""
    height = CoMHeightLimit(0.3, 1.2, 5.0, 20.0, model.nv)
    controller = WholeBodyController(model, extra_limits=[height])
    state, rng = random_state(model, 6), np.random.default_rng(2)
    reference = replace(some_reference(model, state), contacts=contacts)
    controller.terms.update(state)
    controller.step(state, reference)
    qp, limits, active = controller.problem, controller.limits, [k for k in range(2) if contacts[k]]
    assert qp is not None
    torque, cones, joints = limits["torque"], limits["wrench_cone"], limits["joints"]
    assert isinstance(torque, TorqueLimit) and isinstance(cones, WrenchConeLimit) and isinstance(joints, JointLimit)
    sizes = {name: limit.size(len(active)) for name, limit in limits.items()}
    ends = np.cumsum(list(sizes.values()))
    spans = {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}
    assert ends[-1] == len(qp.lower)
    for _ in range(5):
        z = rng.normal(size=len(qp.gradient))
        values = qp.matrix @ z
        command, a, wrenches = controller.builder.recover(z)
        low, high = values - qp.lower, qp.upper - values
        tau = command[2] / torque.largest
        np.testing.assert_allclose(low[spans["torque"]], tau + 1.0, atol=1e-8)
        np.testing.assert_allclose(high[spans["torque"]], 1.0 - tau, atol=1e-8)
        scale = np.ones(model.nj)
        for foot in model.feet:
            scale[np.array(foot.joint_ids_v) - 6] = 0.01
        np.testing.assert_allclose(low[spans["joints"]], scale * (a[6:] - joints.lower), atol=1e-8)
        np.testing.assert_allclose(high[spans["joints"]], scale * (joints.upper - a[6:]), atol=1e-8)
        expected = [cones.upper[k] - cones.matrix[k] @ wrenches[k] for k in active]
        np.testing.assert_allclose(high[spans["wrench_cone"]], np.concatenate([np.zeros(0), *expected]), atol=1e-8)
        data = model.data()
        pin.centerOfMass(model.pin, data, state.q, state.v, a)
        soles = [controller.terms.soles[k].position[2] for k in active or range(2)]
        z_com, speed = data.com[0][2] - min(soles), data.vcom[0][2]
        for slack, bound, sign in ((low, 0.3, 1.0), (high, 1.2, -1.0)):
            limit = 20.0 * (5.0 * (bound - z_com) - speed)
            np.testing.assert_allclose(slack[spans["com_height"]], sign * (data.acom[0][2] - limit), atol=1e-7)


class LastJoint(Task):
    """A task as a user writes it: the last joint at a desired acceleration."""

    def __init__(self, desired: float, nv: int) -> None:
        super().__init__("last_joint", np.array([1e5]), nv)
        self.desired = desired

    def update(self, terms: Terms, reference: Reference) -> None:
        self.jacobian[0, -1] = 1.0
        self.target[0] = self.desired


def test_a_task_of_the_users_own_is_served(model: RobotModel) -> None:
    state = standing(model)
    task = LastJoint(1.5, model.nv)
    controller = WholeBodyController(model, extra_tasks=[task])
    controller.terms.update(state)
    soles = controller.terms.soles
    reference = replace(
        some_reference(model, state),
        contacts=(True, True),
        posture=state.q[7:],
        sole_rotations=np.array([sole.rotation for sole in soles]),
        sole_positions=np.array([sole.position for sole in soles]),
    )
    for value in (1.5, -0.7):
        task.desired = value
        controller.step(state, reference)
        np.testing.assert_allclose(controller.acceleration[-1], value, atol=0.02)
    task.active = False
    controller.step(state, reference)
    assert abs(controller.acceleration[-1] + 0.7) > 0.1
