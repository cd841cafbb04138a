"""Options of ``poise up`` for the plants of real robots, which are in a network and a DDS domain of their own."""

from typing import Any

import yaml

from bridge.launch.robot_network import LOOPBACK_INTERFACE, RobotNetwork
from bridge.plants.config import read_options
from bridge.ros.processes import RATED_NODES
from models.errors import ConfigError

UNITREE, BOOSTER, ROS2_CONTROL = "unitree", "booster", "ros2_control"
PLANTS = (UNITREE, BOOSTER, ROS2_CONTROL)  #: Plants of real robots, by name
#: Profile of the real robot by that of the simulated one
PROFILES = {"g1": "g1_hardware", "talos": "talos_hardware"}
UNITREE_RATE = 500  #: [Hz]


def hardware_options(
    plant: str, robot: str, interface: str, domain: int, rate: int | None, plant_options: str
) -> tuple[str, dict[str, Any]]:
    """Profile, and ``plant_options``, ``rates`` by node and ``robot_network``; ``ConfigError`` says what is missing.

    ``plant`` is one of ``PLANTS``, ``rate`` [Hz] that of the plant when None.
    """
    if plant != ROS2_CONTROL and not interface:
        raise ConfigError(f"--plant {plant} needs --network-interface: this computer's to the robot, such as eth0")
    interface = interface or LOOPBACK_INTERFACE
    given = read_options(plant_options)
    if rate is not None or plant == UNITREE:
        given = {"rate": float(rate or UNITREE_RATE), **given}
    if plant == ROS2_CONTROL:
        from bridge.plants.ros2_control.config import read_config

        rate_of_states = read_config(given).rate
    elif plant == BOOSTER:
        from bridge.plants.booster.codec import read_config as read_booster_config

        rate_of_states = read_booster_config(given).rate
    else:
        rate_of_states = given["rate"]
    network = RobotNetwork(interface, domain, plant, _yaml(given))
    network.check()
    options = {
        "plant_options": _yaml({"network_interface": interface, "domain": domain, **given}),
        "rates": {name: {"sensor_rate": float(rate_of_states)} for name in RATED_NODES},
        "robot_network": network,
    }
    return PROFILES.get(robot, robot), options


def _yaml(values: dict[str, Any]) -> str:
    return yaml.safe_dump(values, default_flow_style=True, width=1 << 16).strip()
