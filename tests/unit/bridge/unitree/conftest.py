"""A start without a robot."""

import pytest

from models.robot_model import RobotModel
from tests.start_bench import Bench


@pytest.fixture
def bench(g1: RobotModel) -> Bench:
    return Bench(g1)
