"""Node ``ground_planner``: plans footsteps on the map of the ground, on request."""

import math
import time
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import UInt8MultiArray

from models.config import default_config
from models.errors import MessageError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.grid_map import grid_map_type, layer_of
from models.nodes.messages import decode as decode_message
from models.nodes.messages import stamp_ns, to_seconds
from models.nodes.parameters import declare, declare_config
from models.nodes.qos import EVENT, SENSOR
from models.nodes.spin import program
from planners.gait.scaling import load_gait_config
from planners.nodes.footstep_messages import require_odom
from planners.nodes.gait_link import decode, encode
from planners.terrain.elevation_map import Heights
from planners.terrain.footholds import GroundPlanner
from planners.terrain.ground_config import GroundConfig
from planners.terrain.ground_route import Answer, Request, answer_request


def ground_from_message(message: Any) -> Heights:
    """Ground heights in ``odom`` of a grid_map_msgs/GridMap, with their deviations if it has the layer ``variance``.

    Raises ``MessageError`` for another frame, without elevations, for layers of different sizes, or for a resolution or
    centre that is not valid.
    """
    require_odom("map", message.header.frame_id)
    values, cell, centre = layer_of(message, "elevation"), float(message.info.resolution), message.info.pose.position
    if not (cell > 0.0 and values.size and math.isfinite(cell + centre.x + centre.y)):
        raise MessageError(f"info.resolution is {cell}, the centre ({centre.x}, {centre.y}), the size {values.shape}")
    x, y = (middle - 0.5 * count * cell for middle, count in zip((centre.x, centre.y), values.shape, strict=True))
    deviations = np.sqrt(np.maximum(layer_of(message, "variance"), 0.0)) if "variance" in message.layers else None
    if deviations is not None and deviations.shape != values.shape:
        raise MessageError(f"the layer variance has the size {deviations.shape}, elevation {values.shape}")
    return Heights(values, (x, y), cell, deviations).closed()


class GroundPlannerNode(PoiseNode):
    """Answers each request with footsteps on the newest map, in a separate process since a plan takes long."""

    AUTOSTART = True

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("ground_planner", **kwargs)
        text = "Largest age of a map at the time of a request; older maps are not used [s]"
        self._age_max = declare(self, "map_age_max", 1.0, text, low=0.05, high=60.0)
        text = "Half of the width that the robot needs on its way around obstacles [m]"
        self._clearance = declare(self, "clearance", 0.4, text, low=0.1, high=1.0)
        self._config = declare_config(self, default_config(GroundConfig, "planners", "ground").plan, "plan.")

    def configure(self) -> None:
        self._law = GroundPlanner(self.model, load_gait_config(self.model), self._config)
        self._missing = ""
        self._answers = self.announce(UInt8MultiArray, topics.GROUND_PLAN, EVENT)
        self.listen(UInt8MultiArray, topics.GROUND_REQUEST, self._on_request, EVENT, while_active=True)
        try:
            self._kind = grid_map_type()
            self.listen(self._kind, topics.TERRAIN_MAP, self._on_map, SENSOR, raw=True)
        except MessageError as error:
            self._missing = str(error)

    def activate(self) -> None:
        self._map: bytes | None = None
        self._plans, self._took = 0, 0.0

    def _on_map(self, data: bytes) -> None:
        self._map = data

    def _on_request(self, message: Any) -> None:
        request, begin = decode(Request, message), time.monotonic()
        found = self._ground(request.stamp)
        if found is None:
            answer = Answer(request.number, reason="no map of the ground", blind=True)
        else:
            ground, stamp = found
            try:
                answer = answer_request(self._law, request, ground, clearance=self._clearance, stamp=stamp)
            except PoiseError as error:
                self.refuse(topics.GROUND_REQUEST, error)
                answer = Answer(request.number, reason=str(error), blind=True)
        self._plans, self._took = self._plans + 1, time.monotonic() - begin
        self._answers.publish(encode(answer))

    def _ground(self, stamp: float) -> tuple[Heights, float] | None:
        """The newest map and its stamp [s]; None if that is more than ``map_age_max`` from the given stamp [s].

        A malformed map is refused and not used.
        """
        if self._map is None:
            return None
        try:
            message = decode_message(self._map, self._kind)
            seen = to_seconds(stamp_ns(message.header.stamp))
            return (ground_from_message(message), seen) if abs(stamp - seen) <= self._age_max else None
        except MessageError as error:
            self.refuse(topics.TERRAIN_MAP, error)
            return None

    def before_diagnostics(self) -> None:
        if not self.active:
            return
        self.level = DiagnosticStatus.WARN if self._missing else DiagnosticStatus.OK
        self.message = self._missing or ("planning" if self._plans else "no request yet")
        self.values |= {"plans": str(self._plans), "newest plan took [ms]": f"{1e3 * self._took:.1f}"}


main = program(GroundPlannerNode)


if __name__ == "__main__":
    main()
