"""Balance law: DCM feedback about a posture, a motion or the steps of a gait, realised by the whole-body QP."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import pinocchio as pin
from msgspec.structs import replace

from controllers.balance.gain_schedule import GainSchedule
from controllers.balance.head import Head
from controllers.balance.motion_player import MotionPlayer
from controllers.balance.posture_reference import posture_frames
from controllers.balance.tick_kernels import (
    BalanceArrays,
    blend_postures,
    blend_rotations,
    feedback_gains,
    feedback_tick,
    standing_reference,
)
from controllers.qp.terms import finite_state
from controllers.whole_body.config import BalanceConfig, WholeBodyConfig, load_balance_config
from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.limits import RowLimit
from controllers.whole_body.tasks import Task
from models.constants import GRAVITY
from models.errors import TrajectoryError
from models.foot import corners_of
from models.numerics.unboxed import Unboxed, unbox
from models.robot_model import RobotModel
from models.spline import min_jerk
from models.tree import read_tree
from models.types import (
    ContactState,
    ControlResult,
    JointCommand,
    JointTrajectory,
    Mode,
    Reference,
    RobotState,
    SolveStatus,
    Vector,
)
from planners.gait.measurement import BodyMotion
from planners.gait.state import GaitPhase, Rest

_UNSOLVED = (SolveStatus.HELD, SolveStatus.DAMPED)


class Gait(Protocol):
    """Gait planner that supplies the references of the steps."""

    @property
    def phase(self) -> GaitPhase:
        """Current phase."""

    @property
    def settled(self) -> bool:
        """Whether the robot has come to a standstill."""

    def reset(self, state: RobotState) -> None:
        """Reset to the state of a robot that stands on both feet."""

    def stop(self) -> None:
        """Come to a standstill within two steps."""

    def step(
        self, state: RobotState, dt: float, rest: Rest | None = None, motion: Unboxed[BodyMotion] | None = None
    ) -> Reference:
        """Return the reference of one tick; ``rest`` is the state in which a standing robot comes to rest.

        ``motion`` is the motion of CoM and soles in ``state``, computed from it when None.
        """


class BalanceController:
    r"""Keeps the CoM above the soles while the joints track a posture, a motion or the steps of a gait.

    .. math::
        \xi = c + \dot c / \omega, \quad \omega = \sqrt{g / z}, \quad
        p = \xi - \dot\xi_{ref}/\omega + k (\xi - \xi_{ref}), \quad
        \ddot c_{xy} = \omega^2 (c - \bar p)

    where ``p_bar`` is the projection of p onto the support polygon. When the DCM nears the edge, ``p_bar`` moves beyond
    the edge by a bounded reach (``controllers/balance/support.py``), and arms and hips supply the momentum that the
    ankles cannot provide. In single support, the planned reaction of the swing leg shifts the polygon
    (``Reference.cmp_offset``).

    The gait runs in every tick. In its standing phase, the reference is the posture on the soles. While it steps, the
    reference is the gait's, with arms and head from the posture. The transition blends both references and the gains.
    In every mode, a standing gait steps when the DCM leaves the soles. A motion then ends for legs and torso, and
    continues for arms and head.

    ``config`` and ``whole_body`` are the packaged gains when None; ``extra_tasks`` and ``extra_limits`` extend the QP;
    ``head`` is optional. Without ``set_gait``, or with ``no_step`` while standing, the feet stay in place.
    ``reference`` is the reference of the last tick; ``capture_margin`` is the distance of the DCM inside the edge of
    the support polygon [m]; ``gains`` are the gains in force, in the order of ``feedback_gains``, followed by
    ``reaction_reach_max`` (8,); ``walking`` is true in mode ``walk``, in which the gait executes commands.

    Assumptions:
        While standing, both soles are on the same plane. The state comes from the estimator.

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
        extra_limits: Sequence[RowLimit] = (),
    ) -> None:
        self.model, self.head = model, head
        self.gait: Gait | None = None
        self._gait_started = False  # whether the gait has been reset
        self.config = config = config or load_balance_config(model)
        self.whole_body = WholeBodyController(model, whole_body, extra_tasks, extra_limits)
        self.motions = MotionPlayer(model, config, head)
        self.no_step, self.walking = config.no_step, False
        terms = self.whole_body.terms
        self._arrays = arrays = BalanceArrays(
            terms.dynamics.poses,
            terms.com,
            terms.com_velocity,
            read_tree(model.pin),
            posture_frames(model),
            self.whole_body.builder.edges,
            np.array([foot.free[:2] for foot in model.feet]),
            np.array([corners_of(area) for area in self.whole_body.areas]),
            *(np.zeros(shape) for shape in ((8,), (2, 3, 3), (2, 3), (2, 4), (3, 3), (3,), (3,))),
            *(np.zeros(shape) for shape in ((3,), (3, 3), (3, 3), (2,), (2,), (3,))),
        )
        self._unboxed = unbox(arrays)
        height = self.whole_body.config.com
        standing, stepping = (
            np.array((*feedback_gains(gains, height), config.reaction_reach_max)) for gains in (config, config.stepping)
        )
        self.schedule = GainSchedule(self.whole_body)
        self.schedule.add("balance", arrays.gains, standing, stepping)
        self.gains = arrays.gains
        self._load_min = config.foothold_load * model.mass * GRAVITY
        self._zero_acceleration, self._zero_xy = np.zeros(3), np.zeros(2)
        self._zero_twists = np.zeros((2, 6))
        self._data, self._leg = model.data(), model.leg_length
        self._first_tick, self._moved, self._share = True, False, 0.0
        self.reference: Reference
        self.capture_margin = 0.0
        self._warm_up()

    def set_gait(self, gait: Gait) -> None:
        """Set the planner of the steps; it is reset in the next tick."""
        self.gait, self._gait_started = gait, False

    @property
    def motion_active(self) -> bool:
        """Whether a motion is being executed."""
        return self.motions.active

    @property
    def stepping(self) -> bool:
        """Whether the robot takes steps or has not come to rest after them."""
        return self.gait is not None and self._gait_started and not self.gait.settled

    def reset(self, state: RobotState) -> None:
        """Reset from a measured state and hold its joint positions as the posture."""
        self.whole_body.reset(state.q[7:])
        self.motions.reset(state.q[7:])
        # Clear all arrays, so that a reset controller returns bit for bit the same commands as a new one.
        arrays = self._arrays
        arrays.anchor[:] = arrays.positions[:] = arrays.seen[:] = 0.0
        arrays.anchor_rotation[:] = arrays.rotations[:] = np.eye(3)
        self._first_tick, self._moved, self.walking = True, False, False
        self._set_share(0.0)
        self._begin(state)

    def _begin(self, state: RobotState) -> None:
        if self.gait is not None:
            self.gait.reset(state)
        self._gait_started = True

    def enter(self, mode: Mode) -> None:
        """Set the mode. In ``walk``, the gait executes its commands; every other mode ends a walk."""
        walk = mode is Mode.WALK and self.gait is not None
        if walk and not self.walking:
            self.motions.stand_up()
        elif self.walking and not walk and self.gait is not None:
            self.gait.stop()
            self.motions.end_walk()
        self.walking = walk

    def follow(self, trajectory: JointTrajectory) -> None:
        """Start a motion from the current posture; while walking, for arms and head only. See ``MotionPlayer``."""
        if self._first_tick:
            raise TrajectoryError("the controller has not run yet: there is no posture to start from")
        self.motions.follow(trajectory, self.reference, walking=self.walking, stepping=self._share > 0.0)

    def stop_motion(self) -> None:
        """Stop a motion and hold the posture reached; while walking, return to the posture of the walk."""
        self.motions.stop(self.reference)

    def step(self, state: RobotState, dt: float) -> ControlResult:
        """Run one tick from the estimated state, ``dt`` [s] after the last one."""
        if finite_state(state.q, state.v):
            self.whole_body.terms.update(state)
            return self._track(state, self._build_reference(state, dt))
        command, status = self.whole_body.fall_back()  # NaN must not enter the state of the law
        return self._result(command, status)

    def track(self, state: RobotState, reference: Reference) -> ControlResult:
        """Run one tick on a given reference, which has ``dcm`` and ``dcm_velocity``, with the gains of stepping."""
        self._set_share(1.0)
        self.whole_body.terms.update(state)
        return self._track(state, reference)

    def _track(self, state: RobotState, reference: Reference) -> ControlResult:
        self.reference = reference
        if not any(reference.contacts):
            return self._hold_in_air(state, reference)
        if self.whole_body.set_support_areas(reference.sole_areas):
            self._arrays.corners[:] = [corners_of(area) for area in self.whole_body.areas]
        has_dcm = reference.dcm is not None and reference.dcm_velocity is not None
        self.capture_margin = feedback_tick(
            self._unboxed,
            *reference.contacts,
            reference.com,
            reference.com_velocity,
            float(reference.com_acceleration[2]),
            self._zero_xy if reference.dcm is None else reference.dcm,
            self._zero_xy if reference.dcm_velocity is None else reference.dcm_velocity,
            has_dcm,
            reference.sole_positions,
            self._zero_xy if reference.cmp_offset is None else reference.cmp_offset,
            reference.momentum,
            reference.levels,
        )
        self.whole_body.com_task.override = self._arrays.acceleration
        return self._result(*self.whole_body.step(state, reference))

    def _result(self, command: JointCommand, status: SolveStatus) -> ControlResult:
        whole_body = self.whole_body
        return ControlResult(
            command=command,
            status=status,
            residual=whole_body.solution.residual if status not in _UNSOLVED else float("nan"),
            acceleration=whole_body.acceleration,
            wrenches=whole_body.wrenches,
            com=whole_body.terms.com.copy(),
            dcm=self._arrays.dcm.copy(),
            zmp=self._arrays.cmp.copy(),
            solve_time=whole_body.solution.time,
        )

    def _hold_in_air(self, state: RobotState, reference: Reference) -> ControlResult:
        """Result without contact: the drivers hold the posture, with the torques of gravity as feed-forward."""
        model, com = self.model, self.whole_body.terms.com
        gravity = pin.computeGeneralizedGravity(model.pin, self._data, state.q)[6:]
        tau = np.clip(gravity, -model.tau_max, model.tau_max)
        return ControlResult(
            command=JointCommand(reference.posture.copy(), reference.posture_velocity.copy(), tau),
            status=SolveStatus.OPTIMAL,
            residual=0.0,
            acceleration=np.zeros(model.nv),
            wrenches=np.zeros((2, 6)),
            com=com.copy(),
            dcm=com[:2].copy(),
            zmp=com[:2].copy(),
        )

    def _build_reference(self, state: RobotState, dt: float) -> Reference:
        """Reference of this tick: of the posture, of the gait, or blended."""
        gait, (standing, dcm, height) = self.gait, self._stand(state, dt)
        if gait is None:
            return standing
        rest = Rest(
            dcm=dcm,
            velocity=standing.com_velocity[:2],
            height=height,
            walk=self.walking,
            step=not self.no_step,
            standing=standing if self._share == 0.0 else None,
        )
        if not self._gait_started:
            self._begin(state)
        planned = gait.step(state, dt, rest, self.whole_body.terms.motion)
        self._advance(gait.phase, planned, dt)
        if self._share == 0.0:
            return replace(standing, sole_areas=planned.sole_areas)
        if not any(planned.contacts):
            return planned
        return self._blend(standing, planned, rest, gait.phase)

    def _stand(self, state: RobotState, dt: float) -> tuple[Reference, Vector, float]:
        """Reference of the posture on the soles, its DCM in W (2,) [m] and its CoM height above the soles [m]."""
        posture, velocity, acceleration = self.motions.step(dt)
        moving = velocity is not self.motions.zero
        fresh, (left, right) = self._first_tick, state.contacts
        arrays = self._arrays
        placed = np.empty((9, 3))  # CoM, its velocity, base and torso rotation (3 rows each); DCM and CoM height
        standing_reference(
            self._unboxed,
            posture,
            fresh or moving or self._moved,
            fresh,
            dt,
            left.wrench,
            right.wrench,
            self._load_min,
            1.0 if fresh or self._share == 1.0 else min(dt / self.config.anchor_time_s, 1.0),
            0.0 if self.gait is None else self._leg,
            placed,
        )
        self._first_tick, self._moved = False, moving
        reference = Reference(
            com=placed[0],
            com_velocity=placed[1],
            com_acceleration=self._zero_acceleration,
            base_orientation=placed[2:5],
            torso_orientation=placed[5:8],
            posture=posture,
            posture_velocity=velocity,
            posture_acceleration=acceleration,
            sole_rotations=arrays.rotations,
            sole_positions=arrays.positions,
            sole_velocities=self._zero_twists,
            sole_accelerations=self._zero_twists,
        )
        return reference, placed[8, :2], float(placed[8, 2])

    def _advance(self, phase: GaitPhase, planned: Reference, dt: float) -> None:
        """Ramp the share of the gait in the references up while it steps, and down while it stands."""
        if phase is GaitPhase.STAND:
            share = max(self._share - dt / self.config.blend_out_s, 0.0)
        else:
            share = min(self._share + dt / self.config.blend_in_s, 1.0)
            if self._share == 0.0:
                self.motions.hold_legs()
        if share == 1.0:
            self.motions.release_legs()
        self._share = share
        self.schedule.apply(1.0 if phase.airborne else share, planned.stiffness, urgent=planned.urgent)

    def _set_share(self, share: float) -> None:
        self._share = share
        self.schedule.apply(share, 1.0)

    def _blend(self, standing: Reference, planned: Reference, rest: Rest, phase: GaitPhase) -> Reference:
        """Take arms and head from the posture, and blend the rest from the posture's reference to the gait's."""
        share = min_jerk(self._share)[0]
        posture, velocity, acceleration = postures = np.empty((3, self.model.nj))
        blend_postures(
            self.motions.free,
            share,
            (standing.posture, standing.posture_velocity, standing.posture_acceleration),
            (planned.posture, planned.posture_velocity, planned.posture_acceleration),
            postures,
        )
        if self._share == 1.0:
            return replace(planned, posture=posture, posture_velocity=velocity, posture_acceleration=acceleration)
        bodies = np.empty((2, 3, 3))
        blend_rotations(
            np.array((standing.base_orientation, standing.torso_orientation)),
            np.array((planned.base_orientation, planned.torso_orientation)),
            share,
            bodies,
        )
        blended = replace(
            planned,
            momentum=standing.momentum + share * (planned.momentum - standing.momentum),
            base_orientation=bodies[0],
            torso_orientation=bodies[1],
            posture=posture,
            posture_velocity=velocity,
            posture_acceleration=acceleration,
        )
        dcm, dcm_velocity = planned.dcm, planned.dcm_velocity
        if phase.airborne or dcm is None or dcm_velocity is None:
            return blended
        soles = np.empty((2, 3, 3))
        blend_rotations(standing.sole_rotations, planned.sole_rotations, share, soles)

        def mix(first: Vector, second: Vector) -> Vector:
            return (1.0 - share) * first + share * second

        return replace(
            blended,
            com=mix(standing.com, planned.com),
            com_velocity=mix(standing.com_velocity, planned.com_velocity),
            dcm=mix(rest.dcm, dcm),
            dcm_velocity=mix(standing.com_velocity[:2], dcm_velocity),
            sole_rotations=soles,
            sole_positions=mix(standing.sole_positions, planned.sole_positions),
        )

    def _warm_up(self) -> None:
        """Compile all kernels and fill all caches, so that no tick waits for the compiler."""
        model = self.model
        foot = ContactState(active=True, wrench=np.zeros(6))
        state = RobotState(0.0, model.standing_configuration(), np.zeros(model.nv), np.zeros(model.nj), (foot, foot))
        self.reset(state)
        if self.step(state, 1e-3).status is not SolveStatus.OPTIMAL:
            raise TrajectoryError(f"{model.name}: the whole-body QP has no solution at the standing posture")
        arrays = self._arrays
        arrays.apart[:] = arrays.anchor_rotation.T @ (arrays.positions[0] - arrays.positions[1])
        planned = replace(self.reference, dcm=self.reference.com[:2].copy(), dcm_velocity=np.zeros(2))
        for contacts in ((True, True), (True, False), (False, True)):
            for offset in (None, np.zeros(2)):
                self.track(state, replace(planned, contacts=contacts, cmp_offset=offset))
        self.reset(state)
        self._blend(planned, planned, Rest(planned.com[:2], planned.com_velocity[:2], 0.0), GaitPhase.STAND)
