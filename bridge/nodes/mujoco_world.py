"""Several simulated robots in one world, in one process: a ``mujoco_bridge`` for each, in its namespace."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from typing import Any

from rclpy.utilities import remove_ros_args

from bridge.nodes.mujoco_bridge import MujocoBridge
from bridge.ros.bridged_world import BridgedWorld
from bridge.ros.processes import absolute_namespace, namespace_rules
from bridge.ros.run_loop import run_plant
from models.errors import PoiseError
from models.nodes.spin import Stop, run


def main(args: list[str] | None = None) -> None:
    """Run the bridges of the namespaces given on the command line; their parameters come with ``--params-file``."""
    given = list(sys.argv if args is None else args)
    names = remove_ros_args(given)[1:]
    if not names or len(set(names)) != len(names):
        sys.exit("mujoco_world: name the robots, each once: mujoco_world robot_1 robot_2 --ros-args --params-file FILE")
    world = BridgedWorld()
    try:
        namespaces = [absolute_namespace(name) for name in names]
    except PoiseError as error:
        sys.exit(str(error))
    rules = ["--ros-args", *namespace_rules()]
    bridges = [partial(MujocoBridge, world, namespace=each, cli_args=rules) for each in namespaces]

    def loop(executor: Any, nodes: Sequence[Any], stop: Stop) -> None:
        world.open()
        try:
            run_plant(executor, [world], stop)
        finally:
            world.close()

    sys.exit(run(list(bridges), given, loop))


if __name__ == "__main__":
    main()
