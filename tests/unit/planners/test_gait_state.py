"""The state of a gait: a copy of it is a checkpoint, and no kernel is compiled while the robot walks."""

from collections.abc import Iterator

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from models.robot_model import RobotModel
from models.types import Reference, RobotState
from planners.gait import adjustment, contact, dcm, footing, footsteps, reaction, reference, swing
from planners.gait.planner import GaitPlanner
from planners.gait.state import GaitPhase, GaitState
from tests.gaits import DT, in_single_support, on_one_foot
from tests.support import standing

MODULES = (adjustment, contact, dcm, footing, footsteps, reaction, reference, swing)


def walked(planner: GaitPlanner, ticks: int) -> Iterator[Reference]:
    """A walk on; the foot that swings lands late."""
    for tick in range(ticks):
        yield planner.step(robot(planner, tick), DT)


def robot(planner: GaitPlanner, tick: int) -> RobotState:
    landed = planner.phase is not GaitPhase.SINGLE or planner.state.elapsed > 0.4
    return standing(planner.model, tick * DT, shares=(0.5, 0.5) if landed else on_one_foot(planner.stance))


def test_a_walk_goes_on_from_a_checkpoint_bit_for_bit(g1: RobotModel) -> None:
    planner = in_single_support(g1)
    saved: list[GaitState] = []
    references: list[Reference] = []
    for expected in walked(planner, 600):
        saved.append(planner.state.copy())
        references.append(expected)
    assert planner.steps >= 2
    for begin in (0, 50, 210, 300):
        again = GaitPlanner(g1)
        again.state = saved[begin].copy()
        for k, expected in enumerate(references[begin + 1 : begin + 200], begin + 1):
            found = again.step(robot(again, k), DT)
            for name in ("com", "dcm", "dcm_velocity", "sole_positions", "sole_accelerations", "sole_areas"):
                np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)


@pytest.mark.parametrize("name", ["g1", "talos"])
def test_construction_compiles_every_kernel_once(name: str) -> None:
    planner = GaitPlanner(RobotModel.load(name))
    assert planner.phase is GaitPhase.STAND and planner.steps == 0 and planner.state.step.time > 0.0
    kernels = [each for module in MODULES for each in vars(module).values() if isinstance(each, Dispatcher)]
    before = {kernel.__name__: len(kernel.signatures) for kernel in kernels}
    planner.reset(standing(planner.model))
    planner.set_velocity(0.2, 0.1, 0.1)
    for _ in walked(planner, 700):
        pass
    assert planner.steps >= 1
    assert {kernel.__name__: len(kernel.signatures) for kernel in kernels} == before
    inner = {"best_step", "rotate"}  # called by kernels alone: nothing of it is loaded where they come from the cache
    assert {name for name, count in before.items() if count == 0} <= inner
