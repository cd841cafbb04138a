"""Gains that depend on whether the robot stands or steps."""

from dataclasses import dataclass

import numpy as np

from controllers.whole_body.controller import WholeBodyController
from models.types import Vector


@dataclass(frozen=True, slots=True)
class ScheduledGains:
    """An array of gains (k,): in force, for standing, for stepping, and for undisturbed (calm) steps.

    The stiffness of the reference interpolates the last two; with ``when_urgent``, an urgent step selects ``stepping``.
    """

    live: Vector
    standing: Vector
    stepping: Vector
    calm: Vector
    when_urgent: bool


class GainSchedule:
    """Interpolates gains between standing and ``WholeBodyConfig.stepping``, linear in the gait's ``share``, 0 to 1 [-].

    The gains of stepping are linear in the ``stiffness`` of the gait's reference, 0 to 1 [-]. The weight of the base is
    larger in an urgent step, since a push at the pelvis and the swing leg rotate the base until it tips over the feet.
    """

    def __init__(self, whole_body: WholeBodyController) -> None:
        self._config = config = whole_body.config.stepping
        self._whole_body, tasks = whole_body, whole_body.tasks
        self.gains: dict[str, ScheduledGains] = {}
        self.share, self.stiffness, self.urgent = 0.0, 1.0, False
        self._scheduled = [tasks[name] for name in ("com", "angular_momentum", "base_orientation")]
        com, momentum, base = (task.weight for task in self._scheduled)
        stepping, calm = com.copy(), com.copy()
        stepping[2], calm[2] = config.com_weight_height, config.com_weight_height_slow
        self.add("com", com, com, stepping, calm)
        stepping = momentum.copy()
        stepping[2] = config.momentum_weight_vertical / whole_body.model.mass**2
        self.add("angular_momentum", momentum, momentum, stepping)
        urgent, calm = (np.full(len(base), weight) for weight in (config.base_weight_urgent, config.base_weight))
        self.add("base_orientation", base, base, urgent, calm, when_urgent=True)
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

    def add(
        self,
        name: str,
        live: Vector,
        standing: Vector,
        stepping: Vector,
        calm: Vector | None = None,
        *,
        when_urgent: bool = False,
    ) -> None:
        """Schedule an array of gains and set it to its standing values; ``calm`` equals ``stepping`` when None."""
        calm = stepping if calm is None else calm
        self.gains[name] = ScheduledGains(live, standing.copy(), stepping, calm, when_urgent)
        live[:] = standing

    def apply(self, share: float, stiffness: float, *, urgent: bool = False) -> None:
        """Set the gains for a share and a stiffness [-], and for an urgent step."""
        if share != self.share:
            self.share, self.stiffness, self.urgent = share, stiffness, urgent
            self.update()
        elif (stiffness, urgent) != (self.stiffness, self.urgent):
            self.stiffness, self.urgent = stiffness, urgent
            for name in ("com", "base_orientation"):
                self._set(self.gains[name])
            self._activate()

    def update(self) -> None:
        """Set the gains after a change of their standing values."""
        for gains in self.gains.values():
            self._set(gains)
        config = self._config
        solver = self._whole_body.config.solver
        self._whole_body.hold_ticks = config.hold_ticks if self.share > 0.0 else solver.hold_ticks
        self._activate()

    def _activate(self) -> None:
        for task in self._scheduled:
            task.active = bool(task.weight.any())

    def _set(self, gains: ScheduledGains) -> None:
        part = float(self.urgent) if gains.when_urgent else self.stiffness
        stepping = gains.calm + part * (gains.stepping - gains.calm)
        gains.live[:] = gains.standing + self.share * (stepping - gains.standing)
