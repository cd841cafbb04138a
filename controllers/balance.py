"""Standing balance: DCM feedback on a posture or a motion, executed by the whole-body QP."""

from __future__ import annotations

import numpy as np

from controllers.kernels_balance import balance_feedback, move_footholds, place_reference
from controllers.posture_reference import PostureReference
from controllers.qp.terms import GRAVITY
from controllers.whole_body import WholeBodyController
from controllers.whole_body_config import BalanceConfig, WholeBodyConfig
from models.config import default_config
from models.errors import TrajectoryError
from models.robot_model import RobotModel
from models.trajectory import TrajectorySampler, validate_trajectory
from models.types import ContactState, ControlResult, JointTrajectory, Reference, RobotState, SolveStatus, Vector


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

    Attributes:
        reference: What the last tick tracked.
        capture_margin: Distance of the DCM inside the support polygon's edge, negative outside [m].

    Assumptions:
        Both soles stand on the same plane. The state comes from the estimator; nothing here knows the truth.

    References:
        Englsberger, Ott, Albu-Schaeffer: Three-dimensional bipedal walking control based on divergent component of
        motion (2015), eq. 12; Pratt et al.: Capture point (2006); Stephens: Humanoid push recovery (2007).
    """

    def __init__(
        self, model: RobotModel, config: BalanceConfig | None = None, whole_body: WholeBodyConfig | None = None
    ) -> None:
        self.model = model
        self.config = config = config or default_config(BalanceConfig, "controllers", "balance")
        self.whole_body = WholeBodyController(model, whole_body)
        self._posture = PostureReference(model)
        self._corners = np.array([foot.corners for foot in model.feet])  # (2, 4, 3)
        com = self.whole_body.config.com
        self._gains = np.array(
            [
                config.dcm_gain,
                config.polygon_margin,
                config.momentum_margin,
                config.momentum_gain,
                config.momentum_reach_max,
                com.kp,
                com.kd,
            ]
        )
        self._least_load = config.foothold_load * model.mass * GRAVITY
        self._cmp = np.zeros(2)
        self._dcm = np.zeros(2)
        self._com_acceleration = np.zeros(3)
        self._anchor_rotation = np.eye(3)
        self._anchor = np.zeros(3)
        self._rotations = np.zeros((2, 3, 3))
        self._rotations[:] = np.eye(3)
        self._positions = np.zeros((2, 3))
        self._zero = np.zeros(model.nj)
        self._still = np.zeros((2, 6))
        self._motion: TrajectorySampler | None = None
        self._motion_time = 0.0
        self._hold = model.posture("stand")
        self._com = np.zeros(3)
        self._com_velocity = np.zeros(3)
        self._fresh = True
        self.capture_margin = 0.0
        self._warm_up()

    @property
    def motion_active(self) -> bool:
        """Whether a motion is being executed."""
        return self._motion is not None

    def reset(self, state: RobotState) -> None:
        """Start over from a measured state, holding its joint positions as the posture."""
        self.whole_body.reset()
        self._motion = None
        self._hold = np.clip(state.q[7:], self.model.q_lower, self.model.q_upper)
        # Nothing of an earlier run may remain, not even in the rounding: a reset controller is a new one.
        self._anchor[:] = self._positions[:] = 0.0
        self._anchor_rotation[:] = self._rotations[:] = np.eye(3)
        self._fresh = True

    def follow(self, trajectory: JointTrajectory) -> None:
        """Start a motion from the present posture reference; a running one is replaced without a jump.

        Raises:
            TrajectoryError: The trajectory is malformed, leaves the limits, or starts elsewhere.
            JointNameError: It names an unknown joint, or one twice.
        """
        if self._fresh:
            raise TrajectoryError("the controller has not run yet: there is no posture to start from")
        start = self.reference.posture
        validate_trajectory(trajectory, self.model, start_q=start)
        self._motion = TrajectorySampler(trajectory, self.model, start, self.reference.posture_velocity)
        self._motion_time = 0.0

    def stop_motion(self) -> None:
        """Hold the posture that the motion has reached."""
        if self._motion is not None:
            self._hold = self.reference.posture.copy()
            self._motion = None

    def step(self, state: RobotState, dt: float) -> ControlResult:
        """One tick.

        Args:
            state: Estimated state.
            dt: Time since the last tick [s].

        Returns:
            Set-point and everything worth recording.
        """
        terms = self.whole_body.terms
        terms.update(state)
        self._move_footholds(state, dt)
        posture, velocity, acceleration = self._sample(dt)
        self.reference = self._refer(posture, velocity, acceleration, dt)
        self._feed_back()
        command, status = self.whole_body.step(state, self.reference)
        return ControlResult(
            command=command,
            status=status,
            residual=self.whole_body.solution.residual,
            acceleration=self.whole_body.acceleration.copy(),
            wrenches=self.whole_body.wrenches.copy(),
            com=terms.com.copy(),
            dcm=self._dcm.copy(),
            zmp=self._cmp.copy(),
            solve_time=self.whole_body.solution.time,
        )

    def _move_footholds(self, state: RobotState, dt: float) -> None:
        left, right = self.whole_body.terms.soles
        move_footholds(
            left.pose,
            right.pose,
            self._fresh or bool(state.contacts[0].wrench[2] > self._least_load),
            self._fresh or bool(state.contacts[1].wrench[2] > self._least_load),
            1.0 if self._fresh else min(dt / self.config.anchor_time_s, 1.0),
            self._rotations,
            self._positions,
            self._anchor_rotation,
            self._anchor,
        )

    def _sample(self, dt: float) -> tuple[Vector, Vector, Vector]:
        if self._motion is None:
            return self._hold, self._zero, self._zero
        self._motion_time += dt
        sample = self._motion.sample(self._motion_time)
        if self._motion_time >= self._motion.duration:
            self._hold = sample[0].copy()
            self._motion = None
        return sample

    def _refer(self, posture: Vector, velocity: Vector, acceleration: Vector, dt: float) -> Reference:
        if self._fresh or velocity is not self._zero:
            before = self._posture.com
            self._posture.update(posture)
            self._com_velocity = self._zero[:3] if self._fresh else (self._posture.com - before) / dt
            self._fresh = False
        else:
            self._com_velocity = self._zero[:3]
        com, com_velocity, base, torso = np.empty(3), np.empty(3), np.empty((3, 3)), np.empty((3, 3))
        place_reference(
            self._anchor_rotation,
            self._anchor,
            self._posture.com,
            self._com_velocity,
            self._posture.base,
            self._posture.torso,
            com,
            com_velocity,
            base,
            torso,
        )
        return Reference(
            com=com,
            com_velocity=com_velocity,
            com_acceleration=self._zero[:3],
            base_orientation=base,
            torso_orientation=torso,
            posture=posture,
            posture_velocity=velocity,
            posture_acceleration=acceleration,
            sole_rotations=self._rotations,
            sole_positions=self._positions,
            sole_velocities=self._still,
            sole_accelerations=self._still,
        )

    def _feed_back(self) -> None:
        """Desired CoM acceleration from the DCM error, written to the CoM task."""
        terms, reference = self.whole_body.terms, self.reference
        left, right = terms.soles
        self.capture_margin = balance_feedback(
            terms.com,
            terms.com_velocity,
            reference.com,
            reference.com_velocity,
            self._anchor[2],
            GRAVITY,
            left.pose,
            right.pose,
            self._corners,
            self._gains,
            self._dcm,
            self._cmp,
            self._com_acceleration,
        )
        self.whole_body.com_task.override = self._com_acceleration

    def _warm_up(self) -> None:
        """Compile and fill every cache at construction: the loop itself never waits for a compiler."""
        model = self.model
        foot = _unloaded()
        state = RobotState(0.0, model.standing_configuration(), np.zeros(model.nv), np.zeros(model.nj), (foot, foot))
        self.reset(state)
        if self.step(state, 1e-3).status is not SolveStatus.OPTIMAL:
            raise TrajectoryError(f"{model.name}: the whole-body QP has no solution at the standing posture")
        self.reset(state)


def _unloaded() -> ContactState:
    return ContactState(active=True, wrench=np.zeros(6))
