"""Service ``obstacle``: puts a box into the robot's way, or takes it out."""

from __future__ import annotations

from typing import Any

from std_srvs.srv import SetBool

from bridge.mujoco_plant import MujocoPlant
from models.errors import CommandError
from models.nodes.base import PoiseNode
from models.nodes.parameters import describe


class ObstacleService:
    """``obstacle`` (SetBool): true stands the box of the terrain at the parameter ``obstacle.place``, false removes it.

    Args:
        node: Node that offers it.
        plant: Whose world.
    """

    def __init__(self, node: PoiseNode, plant: MujocoPlant) -> None:
        self._node, self._plant = node, plant
        if not node.has_parameter("obstacle.place"):
            text = describe("Middle of the box of the service obstacle, x and y in the world [m]", read_only=False)
            node.declare_parameter("obstacle.place", [2.0, 0.0], text)
        node.serve(SetBool, "obstacle", self._on_obstacle)

    def _on_obstacle(self, request: Any, response: Any) -> Any:
        try:
            response.message = self._place() if request.data else self._remove()
            response.success = True
            self._node.get_logger().info(response.message)
        except CommandError as error:
            response.success, response.message = False, str(error)
        return response

    def _place(self) -> str:
        place = self._node.get_parameter("obstacle.place").value
        if len(place) != 2:
            raise CommandError(f"obstacle.place: {len(place)} numbers instead of x and y")
        self._plant.obstacle.place(float(place[0]), float(place[1]))
        return f"obstacle at ({place[0]:g}, {place[1]:g}) m"

    def _remove(self) -> str:
        self._plant.obstacle.remove()
        return "no obstacle"
