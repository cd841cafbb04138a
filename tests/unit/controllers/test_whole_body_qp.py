"""The reduced QP against the full one, its solution against physics, and what happens when it cannot be solved."""

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import quadprog
from msgspec import structs
from scipy.linalg import null_space, orth

from controllers.balance.controller import BalanceController
from controllers.joints.joint_servo import drive_torque
from controllers.qp.active_set import QP, kkt_residual
from controllers.qp.solve import QPSolver, backends
from controllers.whole_body.config import WholeBodyConfig
from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.leg_clearance import LegClearanceLimit
from controllers.whole_body.limits import JointLimit, TorqueLimit, WrenchConeLimit
from models.config import default_config
from models.constants import GRAVITY
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import JointTrajectory, Reference, RobotState, SolveStatus
from tests.support import standing

CONTACTS = [(False, False), (True, False), (False, True), (True, True)]


@pytest.fixture(scope="module", params=["g1", "talos"])
def model(request: pytest.FixtureRequest) -> RobotModel:
    return RobotModel.load(request.param)


def moving_state(model: RobotModel, seed: int, speed: float = 0.2) -> RobotState:
    rng = np.random.default_rng(seed)
    q = model.standing_configuration().copy()
    q[7:] = np.clip(q[7:] + 0.03 * rng.normal(size=model.nj), model.q_lower + 0.03, model.q_upper - 0.03)
    return standing(model, q=q, v=speed * rng.normal(size=model.nv))


def prepare(
    model: RobotModel, state: RobotState, contacts: tuple[bool, bool], areas: np.ndarray | None = None, **solver: Any
) -> tuple[WholeBodyController, Reference]:
    config = default_config(WholeBodyConfig, "controllers", "whole_body")
    config = replace(config, solver=replace(config.solver, **solver)) if solver else config
    balance = BalanceController(model, whole_body=config)
    balance.reset(state)
    balance.step(state, 1e-3)
    balance.whole_body.com_task.override = np.array([0.5, -0.3, 0.2])
    reference = structs.replace(balance.reference, contacts=contacts, sole_areas=areas)
    balance.whole_body.step(state, reference)
    return balance.whole_body, reference


@pytest.mark.parametrize("contacts", CONTACTS[1:])
def test_a_foot_that_bears_alone_keeps_its_load(model: RobotModel, contacts: tuple[bool, bool]) -> None:
    """Also where the body is to fall with 0.8 of gravity; two feet may lose theirs."""
    controller, reference = prepare(model, standing(model), contacts)
    controller.com_task.override = np.array([0.0, 0.0, -0.8 * GRAVITY])
    shares = []
    for least in (0.0, 0.8, 0.0):
        controller.step(standing(model), structs.replace(reference, load_alone=least))
        assert controller.solution.status is SolveStatus.OPTIMAL
        shares.append(controller.wrenches[:, 2].sum() / (model.mass * GRAVITY))
    assert shares[0] < 0.7
    assert shares[1] == pytest.approx(0.8 if sum(contacts) == 1 else shares[0], abs=1e-3)
    assert shares[2] == pytest.approx(shares[0], abs=1e-3)


def test_a_load_that_the_leg_cannot_bear_is_relaxed_in_the_same_tick(model: RobotModel) -> None:
    controller, reference = prepare(model, standing(model), (True, False))
    controller.step(standing(model), structs.replace(reference, load_alone=20.0))
    assert controller.solution.status is SolveStatus.RELAXED
    assert 0.0 < controller.wrenches[0, 2] < 20.0 * model.mass * GRAVITY
    assert (abs(controller.torque) <= model.tau_max).all()


@pytest.mark.parametrize("contacts", CONTACTS)
@pytest.mark.parametrize("seed", range(3))
def test_solution_obeys_physics(model: RobotModel, contacts: tuple[bool, bool], seed: int) -> None:
    state = moving_state(model, seed)
    controller, reference = prepare(model, state, contacts)
    assert controller.solution.status is SolveStatus.OPTIMAL
    assert controller.solution.residual < 1e-6
    data = model.data()
    forces = [pin.Force.Zero() for _ in range(model.pin.njoints)]
    for foot, active in enumerate(contacts):
        frame = model.pin.frames[model.feet[foot].frame_id]
        if not active:
            np.testing.assert_array_equal(controller.wrenches[foot], 0.0)
        forces[frame.parentJoint] += frame.placement.act(pin.Force(controller.wrenches[foot]))
    tau = pin.rnea(model.pin, data, state.q, state.v, controller.acceleration, forces)
    np.testing.assert_allclose(tau[:6], 0.0, atol=1e-7)
    np.testing.assert_allclose(tau[6:], controller.torque, atol=1e-7)
    assert (np.abs(controller.torque) <= model.tau_max + 1e-6).all()
    pin.forwardKinematics(model.pin, data, state.q, state.v, controller.acceleration)
    contact = controller.config.contact
    for foot, active in enumerate(contacts):
        if active:
            frame_id = model.feet[foot].frame_id
            acceleration = pin.getFrameClassicalAcceleration(model.pin, data, frame_id, pin.LOCAL).vector
            velocity = pin.getFrameVelocity(model.pin, data, frame_id, pin.LOCAL).vector
            task = controller.tasks[f"{model.feet[foot].name}_foot"]
            task.update(controller.terms, reference)
            expected = contact.stiffness * task.error - contact.damping * velocity
            np.testing.assert_allclose(acceleration, expected, atol=1e-7)
            assert controller.wrenches[foot, 2] > 0.0


def edge_areas(model: RobotModel, left: str, right: str) -> np.ndarray:
    """What bears of each sole: 'flat', an edge ('toe', 'heel', 'left', 'right') or a corner ('toe left')."""
    areas = np.array([foot.rectangle for foot in model.feet])
    for area, names in zip(areas, (left, right), strict=True):
        for name in names.split():
            if name != "flat":
                low, high = {"toe": (0, 1), "heel": (1, 0), "left": (2, 3), "right": (3, 2)}[name]
                area[low] = area[high]
    return areas


def held_directions(area: np.ndarray) -> np.ndarray:
    """Rows (k, 6) of the acceleration of a sole's origin that stay the same when it turns about its edges."""
    x_min, x_max, y_min, y_max = area
    turns = []
    if x_min == x_max:
        turns.append([0.0, 0.0, x_min, 0.0, 1.0, 0.0])
    if y_min == y_max:
        turns.append([0.0, 0.0, -y_min, 1.0, 0.0, 0.0])
    return null_space(np.array(turns).reshape(-1, 6)).T if turns else np.eye(6)


EDGES = [
    ((True, False), "toe", "flat"),
    ((False, True), "flat", "left"),
    ((True, True), "heel", "flat"),
    ((True, True), "toe", "right"),
    ((True, True), "left", "heel right"),
    ((True, False), "toe left", "toe"),
]


@pytest.mark.parametrize(("contacts", "left", "right"), EDGES)
def test_a_sole_on_its_edge_turns_about_it_without_a_moment(
    model: RobotModel, contacts: tuple[bool, bool], left: str, right: str
) -> None:
    areas = edge_areas(model, left, right)
    state = moving_state(model, 4, 0.4)
    controller, reference = prepare(model, state, contacts, areas)
    assert controller.solution.status is SolveStatus.OPTIMAL
    data, contact = model.data(), controller.config.contact
    pin.forwardKinematics(model.pin, data, state.q, state.v, controller.acceleration)
    for foot in np.flatnonzero(contacts):
        x_min, x_max, y_min, y_max = areas[foot]
        free = np.array([y_min == y_max, x_min == x_max, False])
        pivot = np.array([x_min * free[1], y_min * free[0], 0.0])
        force, moment = controller.wrenches[foot, :3], controller.wrenches[foot, 3:]
        np.testing.assert_allclose((moment - np.cross(pivot, force))[free], 0.0, atol=1e-6)
        assert force[2] > 0.0
        frame_id = model.feet[foot].frame_id
        pose = pin.updateFramePlacement(model.pin, data, frame_id)
        velocity = pin.getFrameVelocity(model.pin, data, frame_id, pin.LOCAL)
        acceleration = pin.getFrameClassicalAcceleration(model.pin, data, frame_id, pin.LOCAL)
        rate, held = velocity.angular, pin.SE3(reference.sole_rotations[foot], reference.sole_positions[foot])
        at_pivot = acceleration.linear + np.cross(acceleration.angular, pivot) + np.cross(rate, np.cross(rate, pivot))
        error = pose.rotation.T @ (held.act(pivot) - pose.act(pivot))
        expected = contact.stiffness * error - contact.damping * (velocity.linear + np.cross(rate, pivot))
        np.testing.assert_allclose(at_pivot, expected, atol=1e-7)
        turned = contact.stiffness * pin.log3(pose.rotation.T @ held.rotation) - contact.damping * rate
        np.testing.assert_allclose(acceleration.angular[~free], turned[~free], atol=1e-7)
        assert (abs(acceleration.angular - turned)[free] > 1e-3).all()


@pytest.mark.parametrize(("contacts", "left", "right"), EDGES)
@pytest.mark.parametrize("speed", [0.1, 0.4])
def test_the_reduced_problem_with_edges_equals_the_full_one(
    model: RobotModel, contacts: tuple[bool, bool], left: str, right: str, speed: float
) -> None:
    state = moving_state(model, 5, speed)
    controller, reference = prepare(model, state, contacts, edge_areas(model, left, right), regularisation=1e-11)
    assert controller.solution.status is SolveStatus.OPTIMAL
    np.testing.assert_allclose(controller.torque, full_solution(controller, reference, state, model), atol=5e-4)


def full_solution(
    controller: WholeBodyController, reference: Reference, state: RobotState, model: RobotModel
) -> np.ndarray:
    """Solve the same problem in (a, w) with explicit equalities and return the joint torques."""
    terms = controller.terms
    builder, nv = controller.builder, model.nv
    active = [foot for foot in range(2) if reference.contacts[foot]]
    n = nv + 6 * len(active)
    hessian, gradient = 1e-13 * np.eye(n), np.zeros(n)
    for task in controller.tasks.values():
        if not task.active:
            continue
        jacobian = np.hstack([task.jacobian, np.zeros((len(task.weight), n - nv))])
        hessian += jacobian.T @ (task.weight[:, None] * jacobian)
        gradient -= jacobian.T @ (task.weight * task.target)
    equalities, right = [], []
    base = np.zeros((6, n))
    base[:, :nv] = terms.mass_matrix[:6]
    torque_rows = np.zeros((model.nj, n))
    torque_rows[:, :nv] = terms.mass_matrix[6:]
    joints, cones, torques, legs = (
        controller.limits[name] for name in ("joints", "wrench_cone", "torque", "leg_clearance")
    )
    assert isinstance(legs, LegClearanceLimit)
    inequalities, bounds = [np.hstack([legs.matrix, np.zeros((len(legs.lower), n - nv))])], [legs.lower]
    assert isinstance(joints, JointLimit) and isinstance(cones, WrenchConeLimit) and isinstance(torques, TorqueLimit)
    for k, foot in enumerate(active):
        span = slice(nv + 6 * k, nv + 6 * k + 6)
        sole = terms.soles[foot]
        weight = builder.stack.wrench_weight[foot]
        hessian[span, span] += np.diag(weight)
        gradient[span] -= weight * controller.wrench_target[foot]
        base[:, span] = -sole.jacobian[:, :6].T
        torque_rows[:, span] = -sole.jacobian[:, 6:].T
        held = held_directions(controller.areas[foot])
        row = np.zeros((len(held), n))
        row[:, :nv] = held @ sole.jacobian
        equalities.append(row)
        right.append(held @ (builder.contact_acceleration[foot] - sole.drift))
        cone = np.zeros((17, n))
        cone[:, span] = cones.matrix[foot]
        opposed = (cones.matrix[foot][:, None] == -cones.matrix[foot]).all(axis=2)  # no moment about an edge
        equalities.append(orth(cone[opposed.any(axis=1)].T).T)
        right.append(np.zeros(len(equalities[-1])))
        cone, lower, upper = (rows[~opposed.any(axis=1)] for rows in (cone, cones.lower[foot], cones.upper[foot]))
        inequalities += [cone, -cone]
        bounds += [lower, -upper]
    equalities.append(base)
    right.append(-terms.bias[:6])
    select = np.hstack([np.zeros((model.nj, 6)), np.eye(model.nj), np.zeros((model.nj, n - nv))])
    inequalities += [torque_rows, -torque_rows, select, -select]
    bounds += [-torques.largest - terms.bias[6:], -torques.largest + terms.bias[6:]]
    bounds += [joints.lower, -joints.upper]
    matrix = np.vstack(equalities + inequalities)
    answer = quadprog.solve_qp(
        hessian, -gradient, matrix.T, np.concatenate(right + bounds), sum(len(r) for r in right)
    )[0]
    return torque_rows @ answer + terms.bias[6:]


@pytest.mark.parametrize("contacts", CONTACTS[1:])
@pytest.mark.parametrize("speed", [0.1, 0.6])
def test_reduced_problem_equals_the_full_one(model: RobotModel, contacts: tuple[bool, bool], speed: float) -> None:
    state = moving_state(model, 5, speed)
    controller, reference = prepare(model, state, contacts, regularisation=1e-11)
    assert controller.solution.status is SolveStatus.OPTIMAL
    np.testing.assert_allclose(controller.torque, full_solution(controller, reference, state, model), atol=2e-4)


def test_limits_are_active_in_the_hard_case(model: RobotModel) -> None:
    """The comparison above must meet active limits, or it proves little."""
    state = moving_state(model, 5, 0.6)
    controller, _ = prepare(model, state, (True, True))
    qp, z = controller.problem, controller.solution.z
    assert qp is not None and z is not None
    values = qp.matrix @ z
    slack = np.minimum(values - qp.lower, qp.upper - values)
    assert (slack < 1e-6).sum() >= 2


def test_a_robot_that_is_thrown_about_is_served_in_the_same_tick(model: RobotModel) -> None:
    """At 2 m/s or rad/s limits contradict each other, and the relaxed answer must be exact enough to be believed."""
    found = [prepare(model, moving_state(model, seed, 2.0), (True, True))[0].solution.status for seed in range(20)]
    assert SolveStatus.RELAXED in found
    assert set(found) <= {SolveStatus.OPTIMAL, SolveStatus.RELAXED}


def toy(second: tuple[float, float] = (1.0, 1.0), **changes: np.ndarray) -> QP:
    """Rows z_1 and ``second`` z; the first is hard."""
    qp = QP(
        np.eye(2),
        np.array([-1.0, -2.0]),
        np.array([[1.0, 0.0], second]),
        np.array([-1.0, -1e30]),
        np.array([1.0, 1.0]),
        np.array([False, True]),
    )
    return qp._replace(**changes)


def solver(backend: str = "own") -> QPSolver:
    return QPSolver(residual_max=1e-6, iterations_max=100, soft_rho=1e-3, backend=backend)


@pytest.mark.parametrize("backend", backends())
def test_every_backend_is_certified(backend: str) -> None:
    solution = solver(backend).solve(toy())
    assert solution.status is SolveStatus.OPTIMAL
    assert solution.residual < 1e-6
    np.testing.assert_allclose(solution.z, [0.0, 1.0], atol=1e-5)
    model = RobotModel.load("g1")
    state = moving_state(model, 5, 0.6)  # with active limits
    own, _ = prepare(model, state, (True, True))
    other, _ = prepare(model, state, (True, True), backend=backend)
    assert other.solution.status in (SolveStatus.OPTIMAL, SolveStatus.FALLBACK_SOLVER)
    assert other.solution.residual < 1e-6
    np.testing.assert_allclose(other.torque, own.torque, atol=2e-3 * model.tau_max.max())


def test_a_wrong_answer_of_a_backend_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    import qpsolvers

    right = qpsolvers.solve_problem

    def wrong(*arguments: object, **options: object) -> qpsolvers.Solution:
        solution = right(*arguments, **options)
        solution.x = solution.x + 0.1
        return solution

    one = solver("quadprog")
    monkeypatch.setattr(qpsolvers, "solve_problem", wrong)
    solution = one.solve(toy())
    assert solution.status is SolveStatus.FALLBACK_SOLVER
    np.testing.assert_allclose(solution.z, [0.0, 1.0], atol=1e-9)


def test_an_unknown_backend_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"unknown back-end 'gurobby'; installed: own, daqp, .*quadprog"):
        solver("gurobby")


def test_solver_finds_the_optimum() -> None:
    solution = solver().solve(toy())
    assert solution.status is SolveStatus.OPTIMAL
    np.testing.assert_allclose(solution.z, [0.0, 1.0], atol=1e-9)


def test_infeasible_problem_is_relaxed_on_its_soft_rows_only() -> None:
    impossible = toy((1.0, 0.0), lower=np.array([-1.0, 5.0]), upper=np.array([1.0, 6.0]))
    solution = solver().solve(impossible)
    assert solution.status is SolveStatus.RELAXED
    assert solution.z is not None and solution.z[0] <= 1.0 + 1e-6
    assert solution.residual < 1e-6


def test_a_soft_row_that_contradicts_itself_is_met_halfway() -> None:
    """At least 0.5 and at most 0.3."""
    solution = solver().solve(toy((1.0, 0.0), lower=np.array([-1.0, 0.5]), upper=np.array([1.0, 0.3])))
    assert solution.status is SolveStatus.RELAXED
    assert solution.z is not None and solution.z[0] == pytest.approx(0.4, abs=5e-3)
    assert solution.residual < 1e-6


def test_relaxed_answer_that_breaks_a_hard_row_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    import controllers.qp.solve as module

    def wrong(*args: object, **kwargs: object) -> tuple[np.ndarray, float, int, dict[str, np.ndarray]]:
        soft = "rho_soft" in kwargs
        return np.array([3.0, 0.0]), 0.0, 2 if soft else -1, {"lam": np.zeros(2)}

    one = solver()
    monkeypatch.setattr(module.daqp, "solve", wrong)
    impossible = toy((1.0, 0.0), lower=np.array([-1.0, 5.0]), upper=np.array([1.0, 6.0]))
    assert one.solve(impossible).status is SolveStatus.HELD


def test_infeasible_hard_rows_are_held() -> None:
    qp = toy(lower=np.array([2.0, 5.0]), upper=np.array([1.0, 6.0]), soft=np.array([False, False]))
    assert solver().solve(qp).status is SolveStatus.HELD


@pytest.mark.parametrize("field", ["hessian", "gradient", "matrix"])
def test_nan_is_held(field: str) -> None:
    qp = toy()
    getattr(qp, field).flat[0] = np.nan
    assert solver().solve(qp).status is SolveStatus.HELD


def test_wrong_answer_of_the_first_solver_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    import controllers.qp.solve as module

    def wrong(*args: object, **kwargs: object) -> tuple[np.ndarray, float, int, dict[str, np.ndarray]]:
        return np.array([0.5, 0.5]), 0.0, 1, {"lam": np.zeros(2)}

    def misled(*arguments: np.ndarray) -> float:
        arguments[-1][:] = 0.5
        return 0.1

    one = solver()
    monkeypatch.setattr(module.daqp, "solve", wrong)
    monkeypatch.setattr(module, "solve_few", misled)
    solution = one.solve(toy())
    assert solution.status is SolveStatus.FALLBACK_SOLVER
    np.testing.assert_allclose(solution.z, [0.0, 1.0], atol=1e-9)


def test_residual_names_each_violation() -> None:
    qp = toy()
    good, multipliers = np.array([0.0, 1.0]), np.array([0.0, 1.0])
    assert kkt_residual(qp, good, multipliers) < 1e-12
    assert kkt_residual(qp, good, np.zeros(2)) > 0.1
    assert kkt_residual(qp, np.array([1.0, 2.0]), np.zeros(2)) > 0.1
    assert kkt_residual(qp, good, -multipliers) > 0.1
    assert np.isnan(kkt_residual(qp, np.array([np.nan, 0.0]), multipliers))


@pytest.mark.parametrize("field", ["q", "v"])
def test_state_that_is_not_finite_holds_then_damps_then_recovers(model: RobotModel, field: str) -> None:
    state = moving_state(model, 1)
    balance = BalanceController(model)
    balance.reset(state)
    good = balance.step(state, 1e-3)
    values = getattr(state, field).copy()
    values[3] = np.nan
    broken = structs.replace(state, **{field: values})
    held = balance.step(broken, 1e-3)
    assert held.status is SolveStatus.HELD and np.isnan(held.residual)
    np.testing.assert_array_equal(held.command.tau, good.command.tau)
    damped = balance.step(broken, 1e-3)
    assert damped.status is SolveStatus.DAMPED
    np.testing.assert_array_equal(drive_torque(model, damped.command, state.q[7:] + 0.1, np.zeros(model.nj)), 0.0)
    assert (drive_torque(model, damped.command, state.q[7:], np.ones(model.nj)) < 0.0).all()
    np.testing.assert_array_equal(damped.command.q, state.q[7:])
    again = balance.step(state, 1e-3)
    assert again.status is SolveStatus.OPTIMAL
    np.testing.assert_allclose(again.command.tau, good.command.tau, atol=1e-6)


def test_nothing_of_an_earlier_run_is_held_after_a_reset(model: RobotModel) -> None:
    state = moving_state(model, 1)
    balance = BalanceController(model)
    balance.reset(state)
    balance.step(state, 1e-3)
    balance.reset(state)
    broken = structs.replace(state, v=np.full(model.nv, np.nan))
    assert balance.step(broken, 1e-3).status is SolveStatus.DAMPED


def test_a_stopped_motion_comes_to_rest_without_a_jump(model: RobotModel) -> None:
    state = moving_state(model, 1)
    balance = BalanceController(model)
    balance.reset(state)
    balance.step(state, 1e-3)
    start = balance.reference.posture
    goal = np.clip(start + 0.2, model.q_lower, model.q_upper)
    balance.follow(JointTrajectory(model.joint_names, np.array([0.0, 1.0]), np.array([start, goal])))
    for _ in range(500):
        balance.step(state, 1e-3)
    speeds = [balance.reference.posture_velocity.copy()]
    assert np.abs(speeds[0]).max() > 0.1
    balance.stop_motion()
    for _ in range(600):
        balance.step(state, 1e-3)
        speeds.append(balance.reference.posture_velocity.copy())
    assert np.abs(np.diff(speeds, axis=0)).max() < 0.01
    np.testing.assert_array_equal(speeds[-1], 0.0)
    assert not balance.motion_active


def test_setpoints_are_where_the_joints_are_when_the_command_arrives(model: RobotModel) -> None:
    state = moving_state(model, 0)
    controller, reference = prepare(model, state, (True, True))
    command, _ = controller.step(state, reference)
    assert command.q == pytest.approx(state.q[7:], abs=0.01)
    controller.set_lookahead(0.02)
    late, _ = controller.step(state, reference)
    joints, rate, acceleration = state.q[7:], state.v[6:], controller.acceleration[6:]
    ahead = np.clip(joints + 0.02 * rate + 0.0002 * acceleration, model.q_lower, model.q_upper)
    assert late.q == pytest.approx(ahead) and late.v == pytest.approx(rate + 0.02 * acceleration)
    assert late.tau == pytest.approx(command.tau)
    controller.set_lookahead(0.0)
    assert controller.step(state, reference)[0].q == pytest.approx(command.q)


def test_the_cones_follow_the_estimated_friction(model: RobotModel) -> None:
    state = moving_state(model, 1)
    controller, reference = prepare(model, state, (True, False))
    known = controller.friction
    controller.step(structs.replace(state, friction=0.2), reference)
    share = controller.config.contact.friction_share
    assert controller.friction == pytest.approx(0.2 * share, abs=controller.config.contact.friction_grain)
    x, y, normal = controller.wrenches[0, :3]
    assert max(abs(x), abs(y)) <= controller.friction / np.sqrt(2.0) * normal + 1e-6
    controller.step(state, reference)  # without an estimate
    assert controller.friction == known
