"""What tests of several parts set up alike."""

import numpy as np

from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import ContactState, RobotState, Vector


def bearing(model: RobotModel, share: float) -> ContactState:
    """A foot that bears a share of the weight at its sole's origin; one without any is in the air."""
    return ContactState(share > 0.0, np.array([0.0, 0.0, share * model.mass * GRAVITY, 0.0, 0.0, 0.0]))


def standing(
    model: RobotModel,
    t: float = 0.0,
    *,
    shares: tuple[float, float] = (0.5, 0.5),
    q: Vector | None = None,
    v: Vector | None = None,
) -> RobotState:
    """A robot that stands still.

    Args:
        model: The robot.
        t: Stamp [s].
        shares: Share of the weight that each foot bears; without any it is in the air (2,) [-].
        q: Another configuration than that of standing (nq,).
        v: Another velocity than none (nv,).
    """
    return RobotState(
        t,
        model.standing_configuration() if q is None else q,
        np.zeros(model.nv) if v is None else v,
        np.zeros(model.nj),
        (bearing(model, shares[0]), bearing(model, shares[1])),
    )
