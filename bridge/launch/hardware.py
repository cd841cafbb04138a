"""Options of ``poise up`` for the plants of real robots, which use a separate network and DDS domain."""

import sys
from typing import Any

import yaml

from bridge.launch.ending import EndConfig
from bridge.launch.parameters import RATED_NODES, time_budget
from bridge.launch.robot_network import LOOPBACK_INTERFACE, RobotNetwork
from bridge.plants.base import find_guard, make_plant
from bridge.plants.config import read_options
from bridge.ros.environment import LAST_DOMAIN
from models.config import default_config, overlaid
from models.errors import ConfigError
from models.robot_model import RobotModel

UNITREE, BOOSTER, ROS2_CONTROL = "unitree", "booster", "ros2_control"
PLANTS = (UNITREE, BOOSTER, ROS2_CONTROL)  #: Plants of real robots, by name
#: Profile of the real robot by the profile of the simulated robot
PROFILES = {"g1": "g1_hardware", "talos": "talos_hardware"}


def hardware_options(
    plant: str,
    robot: str,
    interface: str,
    domain: int | None,
    rate: int | None,
    plant_options: str,
    at_end: str | None = None,
) -> tuple[str, dict[str, Any]]:
    """Profile, and ``plant_options``, ``rates`` by node, ``robot_network`` and ``ending``.

    ``plant`` is one of ``PLANTS``. ``interface``, ``domain`` (0 by default), ``rate`` [Hz] and ``at_end`` may be given
    in the options of the plant instead. Raises ``ConfigError`` for a missing or invalid value, and for two values that
    contradict each other.
    """
    given = read_options(plant_options)
    interface = _agreed("network-interface", interface or None, given, "network_interface")
    domain = _agreed("robot-domain", domain, given, "domain") or 0
    if not isinstance(domain, int) or not 0 <= domain <= LAST_DOMAIN:
        raise ConfigError(f"domain: {domain!r} is not a DDS domain, 0 to {LAST_DOMAIN}")
    if plant != ROS2_CONTROL and not interface:
        raise ConfigError(f"--plant {plant} needs --network-interface, the one to the robot, such as eth0")
    interface = interface or LOOPBACK_INTERFACE
    rate_of_states = _agreed("robot-rate", None if rate is None else float(rate), given, "rate")
    end = _agreed("at-end", at_end, given, "at_end")
    ending = overlaid(default_config(EndConfig, "bridge", "ending"), {"at_end": end} if end else {}, "at_end")
    for name in ("network_interface", "domain", "at_end"):
        given.pop(name, None)
    if rate_of_states is not None:
        given["rate"] = rate_of_states
    speed = 1.0
    if plant == ROS2_CONTROL:
        from bridge.plants.ros2_control.config import read_config

        rate_of_states = read_config(given).rate
    elif plant == BOOSTER:
        from bridge.plants.booster.codec import read_config as read_booster_config

        rate_of_states = read_booster_config(given).rate
    else:
        from bridge.plants.unitree.codec import read_times

        rate_of_states, speed = read_times(given)
    rates = {name: {"sensor_rate": float(rate_of_states)} for name in RATED_NODES}
    rates["balance_controller"] |= time_budget(rate_of_states, speed)
    network = RobotNetwork(interface, domain, plant, _yaml(given))
    network.check()
    options = {
        "plant_options": _yaml({"network_interface": interface, "domain": domain, **given}),
        "rates": rates,
        "robot_network": network,
        "ending": ending,
    }
    return PROFILES.get(robot, robot), options


def check_plant(plant: str, robot: str, plant_options: str) -> None:
    """Create the plant without a connection, before any process starts; ``ConfigError`` for invalid options."""
    make_plant(plant, RobotModel.load(robot), {**read_options(plant_options), "link": object()})


def other_network(plant: str, plant_options: str) -> RobotNetwork | None:
    """Network of a plant from another package that has a guard process; None without a guard or for a simulation.

    Raises ``ConfigError`` for an unknown plant.
    """
    sys.path.append("")  # the processes of the graph also import plants from the working folder
    return RobotNetwork("", 0, plant, plant_options or "{}") if find_guard(plant) else None


def _agreed(argument: str, value: Any, options: dict[str, Any], name: str) -> Any:
    """Value of a command line argument that may also be an option of the plant; None if neither is given."""
    if value is not None and options.get(name, value) != value:
        raise ConfigError(f"--{argument} {value} contradicts '{name}: {options[name]}' of --plant-options: give one")
    return options.get(name) if value is None else value


def _yaml(values: dict[str, Any]) -> str:
    return yaml.safe_dump(values, default_flow_style=True, width=1 << 16).strip()
