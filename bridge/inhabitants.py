"""The robots of one world, as one writes them on the command line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bridge.launch_world import Inhabitant
from bridge.mujoco_world import Place
from bridge.own_motions import own_motions
from bridge.ros.processes import absolute_namespace
from models.errors import ConfigError


def inhabitants(robots: str, places: Sequence[str], motions: Path | None) -> dict[str, Inhabitant]:
    """Read ``robot_1=g1,robot_2=talos`` and ``robot_2=1,-1.5,0``.

    Args:
        robots: Namespace and profile of each, by commas; empty for none.
        places: Where one of them begins: namespace, x and y [m], heading [rad].
        motions: Folder of motion files for all of them; None for none.

    Returns:
        The robots by namespace, in the order given.

    Raises:
        PoiseError: Something cannot be read; it is quoted.
    """
    found: dict[str, str] = {}
    for text in filter(None, robots.split(",")):
        name, equals, robot = text.partition("=")
        name = absolute_namespace(name).strip("/")
        if not name or not equals or not robot.strip():
            raise ConfigError(f"--robots: '{text}' is not NAMESPACE=ROBOT, such as robot_1=g1")
        if name in found:
            raise ConfigError(f"--robots: '{name}' is there twice")
        found[name] = robot.strip()
    begins = dict(map(_place, places))
    for name in begins:
        if name not in found:
            raise ConfigError(f"--place: no robot '{name}' among --robots: {', '.join(found) or 'none'}")
    return {
        name: Inhabitant(robot, begins.get(name), {} if motions is None else own_motions(robot, motions))
        for name, robot in found.items()
    }


def _place(text: str) -> tuple[str, Place]:
    name, _, place = text.partition("=")
    try:
        x, y, heading = (float(value) for value in place.split(","))
    except ValueError:
        raise ConfigError(f"--place: '{text}' is not NAMESPACE=X,Y,HEADING, such as robot_2=0,1.5,0") from None
    return name.strip("/"), Place(x, y, heading)
