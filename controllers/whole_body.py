"""Whole-body controller: terms, tasks, QP, solution, driver set-points, with a documented fallback."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from controllers.qp.build import QP, QPBuilder, QPLimits
from controllers.qp.kernels_cone import share_weight
from controllers.qp.solve import QPSolver, Solution
from controllers.qp.terms import Terms
from controllers.tasks import AngularMomentumTask, CoMTask, FootTask, OrientationTask, PostureTask, Task
from controllers.tasks.base import rows
from controllers.whole_body_config import WholeBodyConfig
from models.config import default_config
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import JointCommand, Matrix, Reference, RobotState, SolveStatus, Vector


class WholeBodyController:
    r"""Accelerations, wrenches and torques that serve weighted tasks within contact and joint limits.

    .. math::
        \min_{a, w} \sum_k \tfrac12 \|J_k a + \dot J_k v - a_k^*\|_{W_k}^2 + \tfrac12 \|w - w_0\|_Q^2
        \quad \text{s.t.} \quad M a + h = S^T \tau + J_c^T w,\; J_c a + \dot J_c v = k\,e_c - d\,v_c,\;
        w \in \text{cone},\; |\tau| \le \tau_{max},\; \underline{a} \le a_j \le \overline{a}

    with ``e_c`` the pose error of a sole to its foothold and ``v_c`` its twist: a light foot that leaves the floor, or
    one that tips, comes back to where it stood.

    Joint limits enter as acceleration bounds: with ``v_hi = min(share v_max, g (q_max - margin - q))`` a joint may
    accelerate by at most ``k (v_hi - v)``, and likewise below.

    The set-point integrates the acceleration over a short look-ahead from the measured state, so the drivers' stiffness
    opposes only what happens after the measurement.

    Fallback: no usable solution repeats the last command for ``hold_ticks`` ticks, then commands damping only.

    Args:
        model: The robot.
        config: Gains and limits; the packaged default when None.
        extra_tasks: Further tasks for the stack.

    Attributes:
        terms: Model terms of the last state.
        tasks: The stack by name.
        com_task: For the balance law's feedback.
        acceleration: Last solution (nv,).
        wrenches: Last solution (2, 6), in the sole frames.
        torque: Last solution (nj,).
        limits: Limits of the QP.
        areas: x_min, x_max, y_min, y_max of what it counts on of each sole, in its frame (2, 4) [m].
        builder: Builds the QP.
        solver: Solves it.
        solution: Last answer of the solver.

    References:
        Del Prete et al.: Prioritized motion-force control of constrained fully-actuated robots (2015);
        Herzog et al.: Momentum control with hierarchical inverse dynamics on a torque-controlled humanoid (2016).
    """

    def __init__(
        self, model: RobotModel, config: WholeBodyConfig | None = None, extra_tasks: Sequence[Task] = ()
    ) -> None:
        self.model = model
        self.config = config = config or default_config(WholeBodyConfig, "controllers", "whole_body")
        self.terms = Terms(model)
        nj, weight_force = model.nj, model.mass * GRAVITY
        com = config.com
        self.com_task = CoMTask(rows(com.kp, 3), rows(com.kd, 3), np.array([com.weight, com.weight, com.weight_height]))
        momentum = config.angular_momentum
        base, torso, foot, posture = config.base_orientation, config.torso_orientation, config.foot, config.posture
        foot_weight = rows(foot.weight, 6)
        foot_weight[3:5] *= config.foot_roll_scale, config.foot_pitch_scale
        self._feet = tuple(FootTask(i, rows(foot.kp, 6), rows(foot.kd, 6), foot_weight) for i in range(2))
        momentum_weight = np.array([momentum.weight, momentum.weight, momentum.weight_vertical]) / model.mass**2
        posture_weight = rows(posture.weight, nj)
        for side in model.feet:
            posture_weight[np.array(side.joint_ids_v) - 6] *= config.posture_leg_scale
        stack: list[Task] = [
            self.com_task,
            AngularMomentumTask(rows(momentum.kd, 3), momentum_weight),
            OrientationTask("base", rows(base.kp, 3), rows(base.kd, 3), rows(base.weight, 3)),
            OrientationTask("torso", rows(torso.kp, 3), rows(torso.kd, 3), rows(torso.weight, 3)),
            *self._feet,
            PostureTask(rows(posture.kp, nj), rows(posture.kd, nj), posture_weight),
            *extra_tasks,
        ]
        self.tasks = {task.name: task for task in stack}
        contact, solver = config.contact, config.solver
        self.builder = QPBuilder(
            model,
            stack,
            force_min=contact.force_min * weight_force,
            force_max=contact.force_max * weight_force,
            friction=contact.friction,
            sole_margin=contact.sole_margin,
            regularisation=solver.regularisation,
            lookahead=config.lookahead_s,
        )
        self.solver = QPSolver(solver.residual_max, solver.iterations_max, solver.soft_rho)
        scale = contact.wrench_weight / weight_force**2
        lever = scale / contact.moment_arm**2
        limit = config.limits
        self.limits = limits = QPLimits(nj)
        limits.torque[:] = limit.torque * model.tau_max
        limits.wrench_weight[:] = scale, scale, scale, lever, lever, lever
        margin = np.minimum(limit.position_margin, 0.25 * (model.q_upper - model.q_lower))
        limits.block["q_low"][:], limits.block["q_high"][:] = model.q_lower + margin, model.q_upper - margin
        limits.block["q_min"][:], limits.block["q_max"][:] = model.q_lower, model.q_upper
        limits.block["v_max"][:] = limit.velocity * model.v_max
        limits.block["gains"][:] = (
            contact.stiffness,
            contact.damping,
            limit.position_gain,
            limit.velocity_gain,
            limit.acceleration,
            contact.linear_max,
            contact.angular_max,
        )
        self._contacts: tuple[tuple[bool, bool], tuple[float, float]] | None = None
        self._whole: Matrix = np.array([foot.rectangle for foot in model.feet])
        self.areas = self._whole.copy()
        self._told = b""
        self.acceleration = np.zeros(model.nv)
        self.wrenches = np.zeros((2, 6))
        self.torque = np.zeros(nj)
        self._problem: QP | None = None
        self.solution = Solution(None, SolveStatus.HELD, float("nan"), 0.0)
        self._failures = 0
        self._last: JointCommand | None = None
        self._joints = model.posture("stand")

    def reset(self, joints: Vector) -> None:
        """Forget the last command and the failure count; ``joints`` is where they are now (nj,) [rad]."""
        self._failures = 0
        self._last = None
        self.solver.reset()
        self._joints = joints
        self.torque = np.zeros(self.model.nj)

    def step(self, state: RobotState, reference: Reference) -> tuple[JointCommand, SolveStatus]:
        """One tick; ``terms`` must have been updated with the same state (the balance law does).

        Args:
            state: Estimated state.
            reference: What to track.

        Returns:
            Set-point for the drivers and how it came about.
        """
        self.rely_on(reference.sole_areas)
        if (reference.contacts, reference.load) != self._contacts:
            self._change_contacts(reference.contacts, reference.load)
        terms, limits = self.terms, self.limits
        self._problem = qp = self.builder.build(terms, reference, limits)
        self.solution = solution = self.solver.solve(qp)
        if solution.z is None:
            return self.fall_back()
        self._failures = 0
        self._joints = state.q[7:]
        command, self.acceleration, self.wrenches = self.builder.recover(solution.z)
        self.torque = command[2]
        self._last = JointCommand(command[0], command[1], self.torque)
        return self._last, solution.status

    @property
    def problem(self) -> QP | None:
        """Last QP with all its rows, overwritten by the next tick; None before the first."""
        self.assemble_rows()
        return self._problem

    def assemble_rows(self) -> None:
        """Fill the rows of the last QP, where it was solved without them."""
        if self._problem is not None and self._problem.complete is not None:
            self._problem.complete()

    def rely_on(self, areas: Matrix | None) -> bool:
        """Count on parts of the soles only (2, 4) [m], None for the whole ones; returns whether anything changed."""
        told = b"" if areas is None else areas.tobytes()
        if told == self._told:  # looked at in every tick: comparing arrays would take 20 us
            return False
        self._told, self._contacts = told, None
        self.areas[:] = self._whole if areas is None else areas
        for foot in range(2):
            self.builder.set_area(foot, self.areas[foot])
        return True

    def _change_contacts(self, contacts: tuple[bool, bool], load: tuple[float, float]) -> None:
        """Feet that swing get their task; those that bear load their planned share, in the middle of what bears."""
        self._contacts = contacts, load
        self.builder.set_load(load)
        for foot, task in enumerate(self._feet):
            task.active = not contacts[foot]
        left, right = (load[foot] if contacts[foot] else 0.0 for foot in range(2))
        share_weight(self.model.mass * GRAVITY, left, right, self.areas, self.limits.wrench_target)

    def fall_back(self) -> tuple[JointCommand, SolveStatus]:
        """Command of a tick without a usable state or solution: the last one once more, then damping where it was."""
        self._failures += 1
        if self._last is not None and self._failures <= self.config.solver.hold_ticks:
            return self._last, SolveStatus.HELD
        zero: Vector = np.zeros(self.model.nj)
        self.torque = zero
        return JointCommand(self._joints.copy(), zero, zero), SolveStatus.DAMPED
