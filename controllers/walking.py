"""Walking: DCM feedback on a gait's reference, executed by the whole-body QP."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from msgspec.structs import replace
from pydantic.dataclasses import dataclass

from controllers.kernels_balance import feedback_gains
from controllers.kernels_tick import WALKING, walking_tick
from controllers.memory import Block
from controllers.whole_body import WholeBodyController
from controllers.whole_body_config import DcmFeedback, NonNegative, Positive, WholeBodyConfig
from models.config import STRICT, default_config
from models.constants import GRAVITY
from models.robot_model import RobotModel, corners_of
from models.types import ContactState, ControlResult, JointCommand, Matrix, Reference, RobotState, SolveStatus


@dataclass(frozen=True, slots=True, config=STRICT)
class WalkingConfig(DcmFeedback):
    """DCM feedback while walking.

    Attributes:
        reaction_reach_max: Farthest that the planned reaction of the swing leg may shift the CMP [m].
        motion_fade: Time in which a motion of the arms is blended into a walk and out of it again [s].
    """

    reaction_reach_max: NonNegative
    motion_fade: Positive


class WalkingController:
    r"""Tracks a reference with a contact schedule.

    .. math::
        p = \xi - \dot\xi_{ref}/\omega + k (\xi - \xi_{ref}), \quad \ddot c_{xy} = \omega^2 (c - \bar p)

    with ``p_bar`` brought into the soles that the reference has in contact: one sole in single support, shifted by the
    planned reaction of the swing leg (``Reference.cmp_offset``).

    Args:
        model: The robot.
        config: Feedback; the packaged default when None.
        whole_body: Gains of the QP; the packaged ones for walking when None.

    Attributes:
        reference: What the last tick tracked.
        capture_margin: Distance of the DCM inside the support polygon's edge, negative outside [m].
    """

    def __init__(
        self, model: RobotModel, config: WalkingConfig | None = None, whole_body: WholeBodyConfig | None = None
    ) -> None:
        self.model = model
        self.config = config = config or default_config(WalkingConfig, "controllers", "walking")
        self.whole_body = WholeBodyController(
            model, whole_body or default_config(WholeBodyConfig, "controllers", "whole_body_walking")
        )
        self._block = block = Block(dict(zip(WALKING, ((2, 4, 3), (8,), (2,), (2,), (3,)), strict=True)))
        self._corners, self._dcm, self._cmp = block["corners"], block["dcm"], block["cmp"]
        self._shape(self.whole_body.areas)
        block["gains"][:] = *feedback_gains(config, self.whole_body.config.com), config.reaction_reach_max
        terms = self.whole_body.terms.block
        self._arguments: tuple[Any, ...] = GRAVITY, terms.data, terms.layout, block.data, block.layout
        self._no_shift = np.zeros(2)
        self._data = model.data()
        self.reference: Reference
        self.capture_margin = 0.0
        self._warm_up()

    def reset(self, state: RobotState) -> None:
        """Forget the last command and start over from a measured state."""
        self.whole_body.reset(state.q[7:])

    def step(self, state: RobotState, reference: Reference, dt: float) -> ControlResult:
        """One tick.

        Args:
            state: Estimated state.
            reference: What to track; its ``dcm`` and ``dcm_velocity`` are given.
            dt: Time since the last tick [s].
        """
        self.reference = reference
        terms = self.whole_body.terms
        terms.update(state)
        if not any(reference.contacts):
            return self._hang(state, reference)
        self._feed_back(reference)
        command, status = self.whole_body.step(state, reference)
        return ControlResult(
            command=command,
            status=status,
            residual=self.whole_body.solution.residual,
            acceleration=self.whole_body.acceleration,
            wrenches=self.whole_body.wrenches,
            com=terms.com.copy(),
            dcm=self._dcm.copy(),
            zmp=self._cmp.copy(),
            solve_time=self.whole_body.solution.time,
        )

    def _hang(self, state: RobotState, reference: Reference) -> ControlResult:
        """In the air there is nothing to push against: the drivers hold the posture and carry the limbs' weight."""
        model, terms = self.model, self.whole_body.terms
        gravity = pin.computeGeneralizedGravity(model.pin, self._data, state.q)[6:]
        tau = np.clip(gravity, -model.tau_max, model.tau_max)
        return ControlResult(
            command=JointCommand(reference.posture.copy(), reference.posture_velocity.copy(), tau),
            status=SolveStatus.OPTIMAL,
            residual=0.0,
            acceleration=np.zeros(model.nv),
            wrenches=np.zeros((2, 6)),
            com=terms.com.copy(),
            dcm=terms.com[:2].copy(),
            zmp=terms.com[:2].copy(),
        )

    def _shape(self, areas: Matrix) -> None:
        """Corners of what bears of the soles."""
        for foot in range(2):
            self._corners[foot] = corners_of(areas[foot])

    def _feed_back(self, reference: Reference) -> None:
        if self.whole_body.rely_on(reference.sole_areas):
            self._shape(self.whole_body.areas)
        self.capture_margin = walking_tick(
            *reference.contacts,
            reference.com,
            reference.com_velocity,
            reference.dcm,  # type: ignore[arg-type]  # a gait gives both
            reference.dcm_velocity,  # type: ignore[arg-type]
            reference.sole_positions,
            self._no_shift if reference.cmp_offset is None else reference.cmp_offset,
            *self._arguments,
        )
        self.whole_body.com_task.override = self._block["acceleration"]

    def _warm_up(self) -> None:
        """Compile at construction what each contact mode needs: the loop itself never waits for a compiler."""
        model, nj = self.model, self.model.nj
        foot = ContactState(active=True, wrench=np.zeros(6))
        state = RobotState(0.0, model.standing_configuration(), np.zeros(model.nv), np.zeros(nj), (foot, foot))
        terms = self.whole_body.terms
        terms.update(state)
        poses = np.array([sole.pose for sole in terms.soles])  # (2, 4, 4)
        reference = Reference(
            com=terms.com.copy(),
            com_velocity=np.zeros(3),
            com_acceleration=np.zeros(3),
            base_orientation=np.eye(3),
            torso_orientation=np.eye(3),
            posture=model.posture("stand"),
            posture_velocity=np.zeros(nj),
            posture_acceleration=np.zeros(nj),
            sole_rotations=np.ascontiguousarray(poses[:, :3, :3]),
            sole_positions=np.ascontiguousarray(poses[:, :3, 3]),
            sole_velocities=np.zeros((2, 6)),
            sole_accelerations=np.zeros((2, 6)),
            dcm=terms.com[:2].copy(),
            dcm_velocity=np.zeros(2),
        )
        for contacts in ((True, True), (True, False), (False, True)):
            for offset in (None, np.zeros(2)):
                self.step(state, replace(reference, contacts=contacts, cmp_offset=offset), 1e-3)
                self.whole_body.assemble_rows()
        self.reset(state)
