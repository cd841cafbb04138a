"""Where the types of this project are not built, nodes do without the services that need them, and say so."""

from typing import Any

import pytest

import models.nodes.services
from controllers.nodes.state_estimator import StateEstimatorNode
from controllers.nodes.supervisor import SupervisorNode
from controllers.stack import ControlStack
from models.errors import MessageError
from planners.nodes.gait_planner import GaitPlannerNode
from planners.nodes.motion_planner import MotionPlannerNode

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("kind", "left"),
    [
        (MotionPlannerNode, None),
        (lambda **kwargs: GaitPlannerNode(ControlStack(), **kwargs), "plan_footsteps"),
        (StateEstimatorNode, "calibrate/imu"),
        (SupervisorNode, "mode/stand"),
    ],
)
def test_everything_else_is_offered(bench: Any, kind: Any, left: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(package: str, part: str, name: str) -> Any:
        raise MessageError(f"no {package}/{part}/{name}: build them")

    monkeypatch.setattr(models.nodes.services, "interface", absent)
    node = bench.add(kind)
    assert node.active and "no poise_interfaces/srv/" in node.values["poise_interfaces"]
    offered = {service.srv_name.removeprefix("/") for service in node.services}
    assert left is None or left in offered
    assert not offered & {"plan_motion", "gait/plan_footsteps", "calibrate", "set_mode", "command"}
