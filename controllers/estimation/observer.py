"""Momentum observer: what pushes the robot, and the sole wrenches that the leg torques speak of."""

from __future__ import annotations

import numpy as np

from controllers.estimation.config import ObserverConfig
from controllers.estimation.kernels_momentum import generalised_momentum
from controllers.estimation.kernels_observer import GAINS, OBSERVER, detect_push, observe
from controllers.estimation.momentum import MomentumModel
from controllers.memory import Block
from models.robot_model import RobotModel
from models.types import CentroidalState, Matrix, PushEstimate, Vector


class ForceObserver:
    r"""Residual of the generalised momentum, for all rows.

    With p = M v and the joint torques less friction, each row is a low-pass of the external torque on it::

        r' = K (p' - (C' v - g + tau) - r)

    evaluated as a difference of momenta, so no acceleration is ever needed. The six rows of the base are taken about
    the CoM in W, where C' v - g is the weight alone. The rows of a leg are due to the sole it ends in: its wrench
    F = (J_leg')^+ r_leg, by damped least squares. What is left of the base's rows is the push::

        push = r_base - (wrenches of the soles at the CoM) - (learnt offset)

    All of it passes both low-passes, that of the joints and that of the push, or a walking robot would push itself.

    Args:
        model: The robot.
        config: Cut-off frequencies, damping and detection.
        gravity: [m/s^2].

    Attributes:
        momentum: Generalised momentum of the last step.
        base: Net external wrench without gravity, feet included: force, moment about the CoM, in W (6,) [N, N.m].
        joints: External torque on each joint (nj,) [N.m].
        estimated: Wrench of each sole from the leg torques, in its frame (2, 6) [N, N.m].
        measured: What the foot sensors say, through the low-pass of the joints (2, 6) [N, N.m].
        weight: [N].

    Raises:
        RobotModelError: A joint is not revolute; names it.

    References:
        A. De Luca, A. Albu-Schaeffer, S. Haddadin, G. Hirzinger: Collision detection and safe reaction with the
        DLR-III lightweight manipulator arm. IROS 2006, eq. 9-12.
        J. Vorndamme, M. Schappler, S. Haddadin: Collision detection, isolation and identification for humanoids.
        ICRA 2017.
    """

    def __init__(self, model: RobotModel, config: ObserverConfig, gravity: float) -> None:
        self.momentum = MomentumModel(model, gravity)
        self.weight = model.mass * gravity
        self._gravity = gravity
        gains = {
            "push_rate": 2.0 * np.pi * config.push_cutoff,
            "joint_rate": 2.0 * np.pi * config.joint_cutoff,
            "damping": config.damping,
            "moment_arm": config.moment_arm,
            "friction_speed": config.friction_speed,
            "weight": self.weight,
            "dead_band": config.dead_band * self.weight,
            "on": config.detect_on * self.weight,
            "off": config.detect_off * self.weight,
            "on_time": config.on_time,
            "off_time": config.off_time,
            "offset_time": config.offset_time,
        }
        self._gains = np.array([gains[name] for name in GAINS])
        shapes = ((6,), (model.nj,), (6,), (model.nj,), (6,), (2, 6), (2, 6), (6,), (6,), (3,), (2,), (6,))
        self._block = block = Block(dict(zip(OBSERVER, shapes, strict=True)))
        self.base, self.joints = block["base"], block["joints"]
        self.estimated, self.measured = block["estimated"], block["measured"]
        legs = np.full((2, max(len(foot.joint_ids_v) for foot in model.feet)), -1, dtype=np.int64)
        for row, foot in zip(legs, model.feet, strict=True):
            row[: len(foot.joint_ids_v)] = np.asarray(foot.joint_ids_v) - 6
        momentum = self.momentum
        self._arguments = (
            self._gains, legs, momentum.bodies.data, momentum.bodies.layout,
            momentum.sweep.data, momentum.sweep.layout, block.data, block.layout,
        )  # fmt: skip
        self._active = False
        self._base_position = np.zeros(3)

    def reset(self, q: Vector, v: Vector, tau: Vector, measured: Matrix, fault: Vector) -> None:
        """Start in a steady state: forces in balance, no push in memory; arguments as for ``update``."""
        self._block.data[:] = 0.0
        self._active = False
        self.update(q, v, tau, measured, fault, 0.0)

    def update(
        self,
        q: Vector,
        v: Vector,
        tau: Vector,
        measured: Matrix,
        fault: Vector,
        dt: float,
        doubtful: bool = False,
    ) -> None:
        """Advance by one step.

        Args:
            q: Configuration (nq,).
            v: Velocity (nv,).
            tau: Joint torques (nj,) [N.m].
            measured: What the foot sensors say, in the sole frames (2, 6) [N, N.m].
            fault: Not 0 where the leg torques are to be believed instead (2,).
            dt: Step; 0 starts in a steady state [s].
            doubtful: Whether a foot sensor is in doubt; then no push begins.
        """
        generalised_momentum(q, v, *self.momentum.arguments)
        observe(v[6:], tau, measured, fault, dt, *self._arguments)
        self._active = detect_push(dt, doubtful, self._gains, self._block.data, self._block.layout)
        self._base_position[:] = q[:3]

    @property
    def push(self) -> PushEstimate:
        """The push now."""
        push = self._block["push"]
        quiet = float(push[:3] @ push[:3]) <= self._gains[GAINS.index("dead_band")] ** 2
        shown = np.zeros(6) if quiet else push.copy()
        return PushEstimate(shown[:3], shown[3:], self._active, self._block["impulse"].copy())

    @property
    def centroidal(self) -> CentroidalState:
        """CoM, DCM, ZMP and momentum of the last state, read off the observer's sweep."""
        momentum, feet = self.momentum, self._block["feet"]
        com = self._base_position + momentum.com
        ground = float(self._base_position[2] + momentum.sole_positions[:, 2].min())
        height = max(float(com[2]) - ground, 0.1)
        dcm = com[:2] + momentum.com_velocity[:2] / np.sqrt(self._gravity / height)
        # Moment about the CoM and force of the soles; the point on the ground where the horizontal moment vanishes.
        load = max(float(feet[2]), 0.05 * self.weight)
        zmp = com[:2] + np.array([-feet[4] - height * feet[0], feet[3] - height * feet[1]]) / load
        return CentroidalState(
            com=com,
            com_velocity=momentum.com_velocity.copy(),
            angular_momentum=momentum.angular_momentum.copy(),
            dcm=dcm,
            zmp=zmp,
        )
