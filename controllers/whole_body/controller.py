"""Whole-body controller: solves a QP of tasks and limits for the setpoints of the drivers, with a safe fallback."""

import math
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from controllers.joints.joint_servo import damping_command
from controllers.qp.active_set import QP
from controllers.qp.contacts import ContactGains
from controllers.qp.solve import QPSolver, Solution
from controllers.qp.terms import Terms
from controllers.whole_body.config import Gains, WholeBodyConfig, load_whole_body_config
from controllers.whole_body.leg_clearance import LegClearanceLimit
from controllers.whole_body.limits import (
    BodyLimits,
    CoMHeightLimit,
    JointBounds,
    JointLimit,
    Limit,
    RowLimit,
    TorqueLimit,
    WrenchConeLimit,
)
from controllers.whole_body.problem import QPBuilder
from controllers.whole_body.tasks import (
    AngularMomentumTask,
    BodyTasks,
    CoMTask,
    FootTask,
    FrameOrientationTask,
    FramePositionTask,
    PostureTask,
    Task,
)
from models.constants import GRAVITY
from models.foot import within
from models.robot_model import RobotModel
from models.types import JointCommand, Matrix, Reference, RobotState, SolveStatus, Vector


class WholeBodyController:
    r"""Computes accelerations, wrenches and torques for weighted tasks within contact and joint limits.

    .. math::
        \min_{a, w} \sum_k \tfrac12 \|J_k a + \dot J_k v - a_k^*\|_{W_k}^2 + \tfrac12 \|w - w_0\|_Q^2
        \quad \text{s.t.} \quad M a + h = S^T \tau + J_c^T w,\; J_c a + \dot J_c v = k\,e_c - d\,v_c,\;
        w \in \text{cone},\; |\tau| \le \tau_{max},\; \underline{a} \le a_j \le \overline{a}

    where ``e_c`` is the pose error of a stance sole from its foothold and ``v_c`` its twist, so a foot that lifts or
    tips returns to its foothold.

    The setpoint integrates the acceleration from the measured state over a look-ahead, the time until the drives
    evaluate the setpoint (``set_lookahead``). The stiffness of the drives then opposes only unplanned motion.

    Fallback: without a usable solution, the last command is repeated for ``hold_ticks`` ticks, then damping only.

    ``config`` is the packaged default when None; ``extra_tasks`` and ``extra_limits`` extend the QP. ``areas`` are
    x_min, x_max, y_min, y_max of the support area of each sole, in its frame (2, 4) [m]; ``wrench_target`` is in the
    sole frames (2, 6). The balance law sets the desired acceleration of ``com_task``. ``acceleration`` (nv,),
    ``wrenches`` (2, 6), ``torque`` (nj,), ``problem`` and ``solution`` are results of the last tick.

    References:
        Del Prete et al.: Prioritized motion-force control of constrained fully-actuated robots (2015);
        Herzog et al.: Momentum control with hierarchical inverse dynamics on a torque-controlled humanoid (2016).
    """

    def __init__(
        self,
        model: RobotModel,
        config: WholeBodyConfig | None = None,
        extra_tasks: Sequence[Task] = (),
        extra_limits: Sequence[RowLimit] = (),
    ) -> None:
        self.model = model
        self.config = config = config or load_whole_body_config(model)
        self._weight = model.mass * GRAVITY
        body, positions = _make_tasks(model, config)
        extra_tasks = [*positions, *extra_tasks]
        self.tasks: dict[str, Task] = {task.name: task for task in (*body, *extra_tasks)}
        self.com_task, self._feet = body.com, body.feet
        contact, solver = config.contact, config.solver
        self._cones = cones = WrenchConeLimit(
            [contact.friction] * len(model.feet),
            contact.sole_margin,
            contact.force_min * self._weight,
            contact.force_max * self._weight,
            self._weight,
        )
        self.body_limits, own = _make_limits(model, config, cones)
        extra_limits = [*own, *extra_limits]
        self.limits: dict[str, Limit] = {limit.name: limit for limit in (*self.body_limits, *extra_limits)}
        frames = [frame for task in self.tasks.values() for frame in task.frames]
        self.terms = Terms(model, frames)
        scale = contact.wrench_weight / self._weight**2
        lever = scale / contact.moment_arm**2
        self.builder = QPBuilder(
            model,
            body,
            self.body_limits,
            extra_tasks=extra_tasks,
            extra_limits=extra_limits,
            contacts=ContactGains(
                np.full(6, contact.stiffness),
                np.full(6, contact.damping),
                np.repeat((contact.linear_max, contact.angular_max), 3),
                self._weight,
            ),
            wrench_weight=np.array([scale, scale, scale, lever, lever, lever]),
            regularisation=solver.regularisation,
            lookahead=config.lookahead_s,
        )
        self.wrench_target = self.builder.stack.wrench_target
        self.solver = QPSolver(solver.residual_max, solver.iterations_max, solver.soft_rho, solver.backend)
        for problem in self.builder.problems:
            self.solver.prepare(problem)
        self._contacts_key: tuple[tuple[bool, ...], tuple[float, ...], float] | None = None
        self._full_areas: Matrix = np.array([foot.bearing for foot in model.feet])
        self.areas = self._full_areas.copy()
        self._areas_key: bytes | None = None
        self._known = min(foot.friction for foot in model.feet)  # of the profile, an upper bound of the estimate
        self.friction = contact.friction  #: Coefficient of the cones [-]
        self._set_friction(math.inf)
        self.set_support_areas(None)
        self.acceleration = np.zeros(model.nv)
        self.wrenches = np.zeros((len(model.feet), 6))
        self.torque = np.zeros(model.nj)
        self.problem: QP | None = None
        self.solution = Solution(None, SolveStatus.HELD, float("nan"), 0.0)
        self.hold_ticks = solver.hold_ticks
        self._failures = 0
        self._last: JointCommand | None = None
        self._damping = damping_command(model)
        self._joints = model.posture("stand")

    def reset(self, joints: Vector) -> None:
        """Discard the last command and the failure count; ``joints`` are the measured positions (nj,) [rad]."""
        self._failures = 0
        self._last = None
        self.set_lookahead(0.0)
        self.solver.reset()
        for limit in self.limits.values():
            limit.reset()
        self._joints = joints
        self.torque = np.zeros(self.model.nj)

    def step(self, state: RobotState, reference: Reference) -> tuple[JointCommand, SolveStatus]:
        """Run one tick from the estimated state. The caller must have updated ``terms``, as the balance law does."""
        self._set_friction(state.friction)
        self.set_support_areas(reference.sole_areas)
        key = reference.contacts, reference.load, reference.load_alone
        if key != self._contacts_key:
            self._contacts_key = key
            self._change_contacts(*key)
        self.problem = self.builder.build(self.terms, reference)
        self.solution = solution = self.solver.solve(self.problem)
        if solution.z is None:
            return self.fall_back()
        self._failures = 0
        self._joints = state.q[7:]
        command, self.acceleration, self.wrenches = self.builder.recover(solution.z)
        self.torque = command[2]
        self._last = JointCommand(command[0], command[1], self.torque)
        return self._last, solution.status

    def set_lookahead(self, time: float) -> None:
        """Set the integration time of the setpoints [s], at least ``lookahead_s``."""
        self.builder.lookahead[0] = max(time, self.config.lookahead_s)

    def set_support_areas(self, areas: Matrix | None) -> bool:
        """Set the support areas of the soles (2, 4) [m], the whole soles if None; returns whether they changed."""
        key = b"" if areas is None else areas.tobytes()
        if key == self._areas_key:  # bytes, since comparing arrays takes 20 us per tick
            return False
        self._areas_key, self._contacts_key = key, None
        self.areas[:] = self._full_areas if areas is None else areas
        for contact, area in enumerate(self.areas):
            area[:] = within(area.tolist(), self.model.feet[contact].bearing)
            self._cones.set_area(contact, area)
        self.builder.set_edges(self.areas)
        return True

    def _set_friction(self, estimate: float) -> None:
        """Set the coefficient of the cones to a share of the estimate [-], rounded down to ``friction_grain``."""
        contact = self.config.contact
        steps = contact.friction_share * min(estimate, self._known) / contact.friction_grain
        friction = min(max(math.floor(steps), 1) * contact.friction_grain, contact.friction)
        if friction != self.friction:
            self.friction, self._areas_key = friction, None
            self._cones.set_friction(friction)

    def _change_contacts(self, contacts: tuple[bool, ...], load: tuple[float, ...], load_alone: float) -> None:
        """Activate the tasks of the swing feet; set target wrenches to the planned load at the centre of each area."""
        self._cones.set_load(load, load_alone if sum(contacts) == 1 else 0.0)
        for foot, free in zip(self._feet, self.builder.edges.free, strict=True):
            foot.release(None if not contacts[foot.foot] else free)
        shares = [share if contact else 0.0 for share, contact in zip(load, contacts, strict=True)]
        total = max(sum(shares), 1e-6)  # no division by zero without a contact
        for target, share, area in zip(self.wrench_target, shares, self.areas.tolist(), strict=True):
            force = self._weight * (share / total)
            target[2:5] = force, 0.5 * force * (area[2] + area[3]), -0.5 * force * (area[0] + area[1])

    def fall_back(self) -> tuple[JointCommand, SolveStatus]:
        """Command of a tick without a usable state or solution: the last command, later damping only."""
        self._failures += 1
        if self._last is not None and self._failures <= self.hold_ticks:
            return self._last, SolveStatus.HELD
        self.torque = np.zeros(self.model.nj)
        return replace(self._damping, q=self._joints.copy()), SolveStatus.DAMPED


def _uniform_gains(gains: Gains, rows: int) -> tuple[Vector, Vector, Vector]:
    """kp, kd and weight of a task, equal for all rows."""
    return np.full(rows, gains.kp), np.full(rows, gains.kd), np.full(rows, gains.weight)


def _make_tasks(model: RobotModel, config: WholeBodyConfig) -> tuple[BodyTasks, list[FramePositionTask]]:
    nv, com, momentum = model.nv, config.com, config.angular_momentum
    foot = _uniform_gains(config.foot, 6)
    foot[2][3:5] *= config.foot_roll_scale, config.foot_pitch_scale
    posture = _uniform_gains(config.posture, model.nj)
    for side in model.feet:
        posture[2][np.array(side.joint_ids_v) - 6] *= config.posture_leg_scale
    momentum_weight = np.array([momentum.weight, momentum.weight, momentum.weight_vertical]) / model.mass**2
    com_weight = np.array([com.weight, com.weight, com.weight_height])
    base, torso = _uniform_gains(config.base_orientation, 3), _uniform_gains(config.torso_orientation, 3)
    body = BodyTasks(
        CoMTask(np.full(3, com.kp), np.full(3, com.kd), com_weight, nv),
        AngularMomentumTask(np.full(3, momentum.kd), momentum_weight, nv),
        FrameOrientationTask("base_orientation", "base_link", *base, nv, lambda reference: reference.base_orientation),
        FrameOrientationTask("torso_orientation", "torso", *torso, nv, lambda reference: reference.torso_orientation),
        [
            FootTask(i, foot[0].copy(), foot[1].copy(), foot[2] * np.append(np.ones(3), np.logical_not(side.free)), nv)
            for i, side in enumerate(model.feet)
        ],
        PostureTask(*posture),
    )
    positions = [
        FramePositionTask(name, task.frame, *_uniform_gains(Gains(task.kp, task.kd, task.weight), 3), nv)
        for name, task in config.tasks.items()
    ]
    return body, positions


def _make_limits(
    model: RobotModel, config: WholeBodyConfig, cones: WrenchConeLimit
) -> tuple[BodyLimits, list[RowLimit]]:
    limit, height, nj = config.limits, config.limits.com_height, model.nj
    margin = np.minimum(limit.position_margin, 0.25 * (model.q_upper - model.q_lower))
    scale = np.ones(nj)  # scale of the rows; eliminating the contacts enlarges the rows of the legs
    for foot in model.feet:
        scale[np.array(foot.chain_ids_v) - 6] = 0.01
    bounds = JointBounds(
        model.q_lower + margin,
        model.q_upper - margin,
        limit.velocity * model.v_max,
        scale,
        np.full(nj, limit.position_gain),
        np.full(nj, limit.velocity_gain),
        np.full(nj, limit.acceleration),
    )
    body = BodyLimits(JointLimit(bounds), cones, TorqueLimit(limit.torque * model.tau_max))
    gains = limit.position_gain, limit.velocity_gain
    extra: list[RowLimit] = []
    if height.enabled:
        extra.append(CoMHeightLimit(height.minimum, height.maximum, *gains, model.nv))
    if limit.legs.enabled:
        extra.append(LegClearanceLimit(model, limit.legs))
    return body, extra
