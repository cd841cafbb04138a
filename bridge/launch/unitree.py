"""Options of ``poise up --plant unitree``."""

from typing import Any

import yaml

from bridge.launch.robot_network import RobotNetwork
from bridge.plants.config import read_options
from bridge.ros.processes import RATED_NODES
from models.errors import ConfigError

PROFILES = {"g1": "g1_hardware"}  #: Profile of the real robot by that of the simulated one


def unitree_options(
    robot: str, interface: str, domain: int, rate: int, plant_options: str
) -> tuple[str, dict[str, Any]]:
    """Profile, and ``plant_options``, ``rates`` by node and ``robot_network``; ``ConfigError`` says what is missing."""
    if not interface:
        raise ConfigError("--plant unitree needs --network-interface: that of this computer to the robot, such as eth0")
    network = RobotNetwork(interface, domain)
    network.check()
    given = {"network_interface": interface, "domain": domain, "rate": float(rate), **read_options(plant_options)}
    options = {
        "plant_options": yaml.safe_dump(given, default_flow_style=True, width=1 << 16).strip(),
        "rates": {name: {"sensor_rate": float(rate)} for name in RATED_NODES},
        "robot_network": network,
    }
    return PROFILES.get(robot, robot), options
