"""Gains that depend on whether the robot stands or steps."""

from dataclasses import dataclass

import numpy as np

from controllers.whole_body.controller import WholeBodyController
from models.types import Vector


@dataclass(frozen=True, slots=True)
class ScheduledGains:
    """One array of gains (k,): those in force, of standing, of stepping, and of slow undisturbed steps."""

    live: Vector
    standing: Vector
    stepping: Vector
    slow: Vector


class GainSchedule:
    """Gains between standing and ``WholeBodyConfig.stepping``, linear in the ``share`` of the gait from 0 to 1 [-].

    Those of stepping are linear in the ``stiffness`` of the gait's reference, likewise.
    """

    def __init__(self, whole_body: WholeBodyController) -> None:
        self._config = config = whole_body.config.stepping
        self._whole_body, tasks = whole_body, whole_body.tasks
        self.gains: dict[str, ScheduledGains] = {}
        self.share, self.stiffness = 0.0, 1.0
        self._momentum = tasks["angular_momentum"]
        com, momentum, base = (tasks[name].weight for name in ("com", "angular_momentum", "base_orientation"))
        stepping, slow = com.copy(), com.copy()
        stepping[2], slow[2] = config.com_weight_height, config.com_weight_height_slow
        self.add("com", com, com, stepping, slow)
        stepping = momentum.copy()
        stepping[2] = config.momentum_weight_vertical / whole_body.model.mass**2
        self.add("angular_momentum", momentum, momentum, stepping)
        self.add("base_orientation", base, base, base * 0.0 + config.base_weight)
        joints, contacts = whole_body.body_limits.joints.bounds, whole_body.builder.contacts
        linear, angular = config.contact_linear_max, config.contact_angular_max
        for name, live, target in (
            ("contact_stiffness", contacts.stiffness, config.contact_stiffness),
            ("contact_damping", contacts.damping, config.contact_damping),
            ("contact_largest", contacts.largest, np.repeat((linear, angular), 3)),
            ("joint_position", joints.position_gain, config.position_gain),
            ("joint_velocity", joints.velocity_gain, config.velocity_gain),
        ):
            self.add(name, live, live, np.full(len(live), target))

    def add(self, name: str, live: Vector, standing: Vector, stepping: Vector, slow: Vector | None = None) -> None:
        """Schedule an array of gains, which is set to its standing values; ``slow`` as ``stepping`` when None."""
        self.gains[name] = ScheduledGains(live, standing.copy(), stepping, stepping if slow is None else slow)
        live[:] = standing

    def apply(self, share: float, stiffness: float) -> None:
        """Set the gains for a share and a stiffness [-]."""
        if share != self.share:
            self.share, self.stiffness = share, stiffness
            self.update()
        elif stiffness != self.stiffness:
            self.stiffness = stiffness
            self._set(self.gains["com"])

    def update(self) -> None:
        """Set the gains after a change of their standing values."""
        for gains in self.gains.values():
            self._set(gains)
        config = self._config
        solver = self._whole_body.config.solver
        self._whole_body.hold_ticks = config.hold_ticks if self.share > 0.0 else solver.hold_ticks
        self._momentum.active = bool(self._momentum.weight.any())

    def _set(self, gains: ScheduledGains) -> None:
        stepping = gains.slow + self.stiffness * (gains.stepping - gains.slow)
        gains.live[:] = gains.standing + self.share * (stepping - gains.standing)
