"""What tests of several parts set up alike."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import ContactState, RobotState, Vector

if TYPE_CHECKING:
    from bridge.closed_loop import ClosedLoop


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


def run_until_still(loop: ClosedLoop, limit: float) -> None:
    """Run until the gait has settled; fails after a fall, or ``limit`` [s]."""
    end = loop.t + limit
    loop.run(0.1)
    while not loop.gait.settled:
        assert loop.t < end and not loop.fallen, loop.fall_reason
        loop.run(0.05)
