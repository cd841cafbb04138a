"""Gaits of the tests, brought to where something is to happen."""

import numpy as np
from msgspec import structs

from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import RobotState
from planners.gait.adjustment import StepPlanner
from planners.gait.config import GaitConfig
from planners.gait.contact import Soles
from planners.gait.measurement import GaitMeasurement, Measurement
from planners.gait.planner import GaitPlanner
from planners.gait.reaction import SwingLeg, leg_lever
from planners.gait.scaling import load_gait_config
from planners.gait.state import GaitPhase
from planners.gait.swing import SwingFoot
from tests.support import standing

DT = 0.002
"""Tick of these gaits [s]."""


def on_one_foot(stance: int) -> tuple[float, float]:
    """Shares of the weight on the feet when one of them bears it alone."""
    return (1.0, 0.0) if stance == 0 else (0.0, 1.0)


def in_single_support(model: RobotModel, config: GaitConfig | None = None, *, stance: int = 1) -> GaitPlanner:
    """A gait that has just lifted its first foot.

    Args:
        model: The robot.
        config: The gait; that of the robot when None.
        stance: The foot that bears.
    """
    planner = GaitPlanner(model, config)
    planner.reset(standing(model))
    planner.set_velocity(0.2, 0.1 if stance == 1 else -0.1, 0.0)  # the foot on the side of the velocity goes first
    while planner.phase is not GaitPhase.SINGLE:
        planner.step(standing(model), DT)
    return planner


def caught(planner: GaitPlanner) -> RobotState:
    """A robot that stands still on its stance foot, whose swing foot is pushed away from its reference.

    Its soles are level, at heading 0: their axes are those of W.
    """
    model, foot = planner.model, 1 - planner.stance
    state = standing(model, planner.state.elapsed, shares=on_one_foot(planner.stance))
    away = np.array(planner.state.measured.soles[foot].place[:2]) - planner.state.swing.position[:2]
    push = 2.0 * planner.config.swing.trip_force * model.mass * GRAVITY
    state.contacts[foot].wrench[:2] = push * away / max(float(np.linalg.norm(away)), 1e-9)
    return state


class Planned:
    """The step planner of a robot, with its parts."""

    def __init__(self, name: str) -> None:
        self.model = RobotModel.load(name)
        self.config: GaitConfig = load_gait_config(self.model)
        self.soles, self.swing = Soles(self.model, self.config), SwingFoot(self.config.swing)
        self.lever = leg_lever(self.model)
        self.plan = StepPlanner(self.config, self.soles, SwingLeg(self.swing.shape, self.lever))
        self.measured = GaitMeasurement(self.model).measure(standing(self.model))

    def with_dcm(self, dcm: np.ndarray) -> Measurement:
        """A robot at rest whose CoM is at a DCM."""
        return structs.replace(self.measured, com=np.array([*dcm, self.measured.com[2]]), com_velocity=np.zeros(3))
