"""Standing balance: DCM feedback on a posture or a motion, executed by the whole-body QP."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from controllers.head import Head
from controllers.kernels_balance import feedback_gains
from controllers.kernels_tick import BALANCE, balance_tick
from controllers.memory import Block
from controllers.posture_reference import PostureReference
from controllers.qp.kernels_check import finite_state
from controllers.tasks import Task
from controllers.whole_body import WholeBodyController
from controllers.whole_body_config import BalanceConfig, WholeBodyConfig
from models.config import default_config
from models.constants import GRAVITY
from models.errors import TrajectoryError
from models.robot_model import RobotModel
from models.trajectory import TrajectorySampler, validate_trajectory
from models.types import ContactState, ControlResult, JointTrajectory, Reference, RobotState, SolveStatus, Vector

_UNSOLVED = (SolveStatus.HELD, SolveStatus.DAMPED)


class BalanceController:
    r"""Keeps the CoM over the soles while the joints follow a posture or a motion.

    .. math::
        \xi = c + \dot c / \omega, \quad \omega = \sqrt{g / z}, \quad
        p = \xi - \dot\xi_{ref}/\omega + k (\xi - \xi_{ref}), \quad
        \ddot c_{xy} = \omega^2 (c - \bar p)

    where ``p_bar`` is p brought into the support polygon, or beyond its edge by a bounded reach when the DCM itself
    nears the edge (``controllers/support.py``): then arms and hips add the momentum that ankles cannot.

    Args:
        model: The robot.
        config: Gains; the packaged default when None.
        whole_body: Gains of the QP; the packaged default when None.
        extra_tasks: Further tasks for the stack of the QP.
        head: Turns the head while it stands; None for nobody. ``reset`` leaves it alone, as both laws share it.

    Attributes:
        reference: What the last tick tracked.
        capture_margin: Distance of the DCM inside the support polygon's edge, negative outside [m].
        gains: Of the feedback, as ``feedback_gains`` orders them (7,); what is changed here counts from the next tick.

    Assumptions:
        Both soles stand on the same plane. The state comes from the estimator; nothing here knows the truth.

    References:
        Englsberger, Ott, Albu-Schaeffer: Three-dimensional bipedal walking control based on divergent component of
        motion (2015), eq. 12; Pratt et al.: Capture point (2006); Stephens: Humanoid push recovery (2007).
    """

    def __init__(
        self,
        model: RobotModel,
        config: BalanceConfig | None = None,
        whole_body: WholeBodyConfig | None = None,
        extra_tasks: Sequence[Task] = (),
        head: Head | None = None,
    ) -> None:
        self.model, self.head = model, head
        self.config = config = config or default_config(BalanceConfig, "controllers", "balance")
        self.whole_body = WholeBodyController(model, whole_body, extra_tasks)
        posture = PostureReference(model)
        shapes = ((2, 4, 3), (7,), (2, 3, 3), (2, 3), (3, 3), (3,), (2,), (2,), (3,), (3,), (3, 3), (3, 3))
        self._block = block = Block(dict(zip(BALANCE, shapes, strict=True)))
        block["corners"][:] = [foot.corners for foot in model.feet]
        self.gains = block["gains"]
        self.gains[:] = feedback_gains(config, self.whole_body.config.com)
        self._rotations, self._positions = block["rotations"], block["positions"]
        self._anchor_rotation, self._anchor = block["anchor_rotation"], block["anchor"]
        self._dcm, self._cmp = block["dcm"], block["cmp"]
        self._com_acceleration = block["acceleration"]
        terms = self.whole_body.terms.block
        self._arguments = (
            GRAVITY,
            terms.data,
            terms.layout,
            posture.tree.data,
            posture.tree.layout,
            posture.parents,
            posture.bodies,
            block.data,
            block.layout,
        )
        self._least_load = config.foothold_load * model.mass * GRAVITY
        self._zero = np.zeros(model.nj)
        self._no_acceleration = np.zeros(3)
        self._still = np.zeros((2, 6))
        self._motion: TrajectorySampler | None = None
        self._motion_time = 0.0
        self._hold = model.posture("stand")
        self._fresh = True
        self.capture_margin = 0.0
        self._warm_up()

    @property
    def motion_active(self) -> bool:
        """Whether a motion is being executed."""
        return self._motion is not None

    def reset(self, state: RobotState) -> None:
        """Start over from a measured state, holding its joint positions as the posture."""
        self.whole_body.reset(state.q[7:])
        self._motion = None
        self._hold = np.clip(state.q[7:], self.model.q_lower, self.model.q_upper)
        # Nothing of an earlier run may remain, not even in the rounding: a reset controller is a new one.
        self._anchor[:] = self._positions[:] = 0.0
        self._anchor_rotation[:] = self._rotations[:] = np.eye(3)
        self._fresh = True

    def follow(self, trajectory: JointTrajectory) -> None:
        """Start a motion from the present posture reference; a running one is replaced without a jump.

        A lone point without velocities takes at least ``set_point_time_s``; so a stream of them is followed smoothly. A
        motion that does not end at rest slows down after its end as a stopped one does.

        Raises:
            TrajectoryError: The trajectory is malformed, leaves the limits, or starts elsewhere.
            JointNameError: It names an unknown joint, or one twice.
        """
        if self._fresh:
            raise TrajectoryError("the controller has not run yet: there is no posture to start from")
        if len(trajectory.times) == 1 and trajectory.velocities is None:  # a set-point, perhaps one of a stream
            trajectory = replace(trajectory, times=np.maximum(trajectory.times, self.config.set_point_time_s))
        start, speed = self._start(trajectory)
        validate_trajectory(trajectory, self.model, start_q=start)
        self._motion = TrajectorySampler(trajectory, self.model, start, speed)
        self._motion_time = 0.0

    def stop_motion(self) -> None:
        """Slow down from where the motion is, within ``stop_time_s``, and hold the posture reached."""
        if self._motion is None:
            return
        start, speed = self._start(None)
        time = self.config.stop_time_s
        end = np.clip(start + 0.5 * time * speed, self.model.q_lower, self.model.q_upper)
        stop = JointTrajectory(self.model.joint_names, np.array([time]), end[None], np.zeros((1, self.model.nj)))
        self._motion = TrajectorySampler(stop, self.model, start, speed)
        self._motion_time = 0.0

    def step(self, state: RobotState, dt: float) -> ControlResult:
        """One tick.

        Args:
            state: Estimated state.
            dt: Time since the last tick [s].

        Returns:
            Set-point and everything worth recording.
        """
        terms = self.whole_body.terms
        if finite_state(state.q, state.v):
            terms.update(state)
            self.reference = self._refer(state, dt)
            command, status = self.whole_body.step(state, self.reference)
        else:  # nothing that is kept from tick to tick may see it
            command, status = self.whole_body.fall_back()
        return ControlResult(
            command=command,
            status=status,
            residual=self.whole_body.solution.residual if status not in _UNSOLVED else float("nan"),
            acceleration=self.whole_body.acceleration,
            wrenches=self.whole_body.wrenches,
            com=terms.com.copy(),
            dcm=self._dcm.copy(),
            zmp=self._cmp.copy(),
            solve_time=self.whole_body.solution.time,
        )

    def _start(self, motion: JointTrajectory | None) -> tuple[Vector, Vector]:
        """Posture and its rate from which a motion, or the end of one, goes on."""
        if self.head is None:
            return self.reference.posture, self.reference.posture_velocity
        return self.head.without(self.reference, motion)

    def _sample(self, dt: float) -> tuple[Vector, Vector, Vector]:
        if self._motion is None:
            return self._hold, self._zero, self._zero
        self._motion_time += dt
        if self._motion_time >= self._motion.duration and self._motion.ends_moving:
            self.stop_motion()
            self._motion_time = dt
        sample = self._motion.sample(self._motion_time)
        if self._motion_time >= self._motion.duration:
            self._hold = sample[0].copy()
            self._motion = None
        return sample

    def _refer(self, state: RobotState, dt: float) -> Reference:
        """What to track on this tick; the DCM feedback goes to the CoM task."""
        posture, velocity, acceleration = self._sample(dt)
        if self.head is not None:
            posture, velocity, acceleration = self.head.step(posture, velocity, acceleration, dt)
        fresh, (left, right) = self._fresh, state.contacts
        placed = np.empty((8, 3))
        self.capture_margin = balance_tick(
            posture,
            fresh or velocity is not self._zero,
            fresh,
            dt,
            left.wrench,
            right.wrench,
            self._least_load,
            1.0 if fresh else min(dt / self.config.anchor_time_s, 1.0),
            *self._arguments,
            placed,
        )
        self.whole_body.com_task.override = self._com_acceleration
        self._fresh = False
        return Reference(
            com=placed[0],
            com_velocity=placed[1],
            com_acceleration=self._no_acceleration,
            base_orientation=placed[2:5],
            torso_orientation=placed[5:],
            posture=posture,
            posture_velocity=velocity,
            posture_acceleration=acceleration,
            sole_rotations=self._rotations,
            sole_positions=self._positions,
            sole_velocities=self._still,
            sole_accelerations=self._still,
        )

    def _warm_up(self) -> None:
        """Compile and fill every cache at construction: the loop itself never waits for a compiler."""
        model = self.model
        foot = _unloaded()
        state = RobotState(0.0, model.standing_configuration(), np.zeros(model.nv), np.zeros(model.nj), (foot, foot))
        self.reset(state)
        if self.step(state, 1e-3).status is not SolveStatus.OPTIMAL:
            raise TrajectoryError(f"{model.name}: the whole-body QP has no solution at the standing posture")
        self.whole_body.assemble_rows()  # standing still needs none
        self.reset(state)


def _unloaded() -> ContactState:
    return ContactState(active=True, wrench=np.zeros(6))
