"""Terms, tasks and the wrench cone against Pinocchio, finite differences and corner forces."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from msgspec.structs import replace

from controllers.qp.kernels_cone import ROWS, fill_cone
from controllers.qp.kernels_terms import rotation_error
from controllers.qp.terms import Terms
from controllers.tasks import AngularMomentumTask, CoMTask, FootTask, OrientationTask, PostureTask, Task
from controllers.whole_body import WholeBodyController
from controllers.whole_body_config import WholeBodyConfig
from models.config import default_config
from models.robot_model import RobotModel
from models.types import Matrix, Reference, RobotState, Vector
from tests.support import standing

ROBOTS = ("g1", "talos")


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
    terms = Terms(model)
    terms.update(state)
    data = model.data()
    q, v = state.q, state.v
    pin.forwardKinematics(model.pin, data, q, v, np.zeros(model.nv))
    pin.updateFramePlacements(model.pin, data)
    pin.computeJointJacobians(model.pin, data, q)
    for frame in (*terms.soles, terms.torso):
        jacobian = pin.getFrameJacobian(model.pin, data, frame.frame_id, pin.LOCAL)
        drift = pin.getFrameClassicalAcceleration(model.pin, data, frame.frame_id, pin.LOCAL).vector
        np.testing.assert_allclose(frame.pose, data.oMf[frame.frame_id].homogeneous, atol=1e-12)
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


@pytest.mark.parametrize("name", ["com", "torso_orientation", "base_orientation", "left_foot", "right_foot", "posture"])
def test_jacobian_is_minus_the_derivative_of_the_error(model: RobotModel, name: str) -> None:
    ones = np.ones(6)
    tasks = {
        task.name: task
        for task in (
            CoMTask(ones[:3], ones[:3], ones[:3]),
            OrientationTask("torso", ones[:3], ones[:3], ones[:3]),
            OrientationTask("base", ones[:3], ones[:3], ones[:3]),
            FootTask(0, ones, ones, ones),
            FootTask(1, ones, ones, ones),
            PostureTask(np.ones(model.nj), np.ones(model.nj), np.ones(model.nj)),
        )
    }
    task = tasks[name]
    state = random_state(model, 11)
    terms = Terms(model)
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
    jacobian = task.jacobian(terms).copy()
    step = 1e-6
    for column in range(model.nv):
        direction = np.zeros(model.nv)
        direction[column] = step
        errors = []
        for sign in (1.0, -1.0):
            q = pin.integrate(model.pin, state.q, sign * direction)
            terms.update(RobotState(0.0, q, state.v, state.tau, state.contacts))
            errors.append(task.error(terms, reference).copy())
        np.testing.assert_allclose((errors[0] - errors[1]) / (2 * step), -jacobian[:, column], atol=2e-5)


def test_momentum_task_damps(model: RobotModel) -> None:
    state = random_state(model, 2)
    terms = Terms(model)
    terms.update(state)
    task = AngularMomentumTask(np.full(3, 4.0), np.ones(3))
    np.testing.assert_allclose(task.acceleration(terms, some_reference(model, state)), -4.0 * terms.momentum)


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
    matrix, lower, upper = np.empty((ROWS, 6)), np.empty(ROWS), np.empty(ROWS)
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


@pytest.mark.parametrize("contacts", [(True, True), (True, False), (False, True)])
def test_compiled_rows_are_those_of_the_tasks(model: RobotModel, contacts: tuple[bool, bool]) -> None:
    """``stack_tasks`` never calls the tasks; what it writes is what they say."""
    controller = WholeBodyController(model, default_config(WholeBodyConfig, "controllers", "whole_body_walking"))
    rng, state = np.random.default_rng(5), random_state(model, 5)
    for task in controller.tasks.values():
        for gains in (getattr(task, name, None) for name in ("kp", "kd", "weight")):
            if gains is not None:
                gains[:] = rng.uniform(1.0, 9.0, size=gains.shape)  # changed in place, as by a user who tunes
    reference = replace(some_reference(model, state), contacts=contacts, heading_rate=0.4)
    controller.com_task.override = rng.normal(size=3)
    controller.terms.update(state)
    controller.step(state, reference)
    builder, terms, first = controller.builder, controller.terms, 0
    found = builder.stacked
    for task in builder.tasks:
        span = slice(first, first + task.weight.shape[0])
        first = span.stop
        if not task.active:
            assert (found["weight"][span] == 0.0).all()
            continue
        np.testing.assert_array_equal(found["weight"][span], task.weight)
        np.testing.assert_allclose(found["jacobian"][span], task.jacobian(terms), atol=1e-14)
        target = task.acceleration(terms, reference) - task.drift(terms)
        np.testing.assert_allclose(found["target"][span], target, rtol=1e-12, atol=1e-12)
    assert [task.active for task in builder.tasks if isinstance(task, FootTask)] == [not foot for foot in contacts]
    wanted = builder.posture.acceleration(terms, reference)
    np.testing.assert_allclose(found["posture_target"], wanted, rtol=1e-12)
    np.testing.assert_array_equal(found["posture_weight"], builder.posture.weight)


class LastJoint(Task):
    """A task as a user writes it: the last joint at a wanted acceleration."""

    name = "last_joint"

    def __init__(self, wanted: float) -> None:
        self.active, self.weight, self.wanted = True, np.array([1e5]), wanted

    def error(self, terms: Terms, reference: Reference) -> Vector:
        return np.zeros(1)

    def jacobian(self, terms: Terms) -> Matrix:
        return np.eye(terms.v.shape[0])[-1:]

    def drift(self, terms: Terms) -> Vector:
        return np.zeros(1)

    def acceleration(self, terms: Terms, reference: Reference) -> Vector:
        return np.array([self.wanted])


def test_a_task_of_the_users_own_is_served(model: RobotModel) -> None:
    state = standing(model)
    task = LastJoint(1.5)
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
    for wanted in (1.5, -0.7):
        task.wanted = wanted
        controller.step(state, reference)
        np.testing.assert_allclose(controller.acceleration[-1], wanted, atol=0.02)
    task.active = False
    controller.step(state, reference)
    assert abs(controller.acceleration[-1] + 0.7) > 0.1
