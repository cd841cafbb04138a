"""Network of a real robot: the processes that join it, and the Fast DDS profile that lets only them join.

All participants of a process share its transports. Driver and guard therefore get a profile with loopback and the
address of one interface; the rest of the graph stays on loopback. The robot is discovered by multicast in a separate
DDS domain. The domain of the graph must differ, or its topics would be offered to the network of the robot.
"""

import fcntl
import secrets
import socket
import struct
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, replace

from bridge.launch.layout import BRIDGE
from bridge.plants.hardware import SESSION, real_robot
from bridge.ros.environment import LOOPBACK_PROFILE, PROFILE_VARIABLE, ros_domain
from bridge.ros.processes import ProcessSpec
from models.errors import ConfigError
from models.files import state_folder

_XML = "http://www.eprosima.com"  #: Namespace of the profile
_GET_ADDRESS, _GET_FLAGS = 0x8915, 0x8913  #: ioctl of Linux: IPv4 address and flags of an interface
_UP = 0x1  #: Flag of an interface that is up
SPDP_GROUP = "239.255.0.1"  #: Multicast group of discovery (DDSI-RTPS 9.6.1)
LOOPBACK, LOOPBACK_INTERFACE = "127.0.0.1", "lo"
GUARD = "bridge.nodes.damping_guard"  #: Module of the guard process


def interface_address(name: str) -> str:
    """IPv4 address of a network interface that is up; otherwise a ``ConfigError`` lists the known interfaces."""
    known = [each for _, each in socket.if_nameindex()]
    if name not in known:
        raise ConfigError(f"--network-interface: no interface '{name}'; known: {', '.join(known)}")
    request = struct.pack("256s", name.encode())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            (flags,) = struct.unpack_from("H", fcntl.ioctl(probe, _GET_FLAGS, request), 16)
            address = socket.inet_ntoa(fcntl.ioctl(probe, _GET_ADDRESS, request)[20:24])
        except OSError as error:
            raise ConfigError(
                f"--network-interface: '{name}' has no IPv4 address; give it one in the robot's network, such as "
                f"sudo ip address add 192.168.123.222/24 dev {name}"
            ) from error
    if not flags & _UP:
        raise ConfigError(f"--network-interface: '{name}' is down: sudo ip link set {name} up")
    return address


def profile_text(address: str) -> str:
    """Fast DDS profile ``bridge/config/loopback.xml`` with an additional interface and multicast discovery."""
    ET.register_namespace("", _XML)
    root = ET.parse(LOOPBACK_PROFILE).getroot()
    if address != LOOPBACK:
        allowed = _one(root, "interfaceWhiteList")
        ET.SubElement(allowed, f"{{{_XML}}}address").text = address
        builtin = _one(root, "builtin")
        builtin.remove(_one(builtin, "metatrafficUnicastLocatorList"))  # it excludes multicast
        peers = _one(root, "initialPeersList")
        peer = ET.SubElement(ET.SubElement(peers, f"{{{_XML}}}locator"), f"{{{_XML}}}udpv4")
        ET.SubElement(peer, f"{{{_XML}}}address").text = SPDP_GROUP
    return ET.tostring(root, encoding="unicode")


def _one(root: ET.Element, name: str) -> ET.Element:
    found = root.find(f".//{{{_XML}}}{name}")
    if found is None:
        raise ConfigError(f"loopback.xml: no element '{name}'")
    return found


@dataclass(frozen=True, slots=True)
class RobotNetwork:
    """Connection to a real robot: interface of this computer, DDS domain of the robot, plant and plant options.

    Without an interface, driver and guard stay on loopback, and the plant connects to the robot by other means.
    """

    interface: str
    domain: int = 0
    plant: str = "unitree"
    options: str = "{}"

    def check(self, graph_domain: int | None = None) -> str:
        """Address of the interface; ``ConfigError`` if there is none, or if the graph uses the domain of the robot."""
        graph = ros_domain(graph_domain)
        if graph == self.domain:
            raise ConfigError(
                f"ROS domain {graph} is that of the robot: the graph's topics would appear in its network; choose "
                f"another one in every terminal, such as export ROS_DOMAIN_ID={self.domain + 1}"
            )
        return interface_address(self.interface)

    def processes(self, specs: Sequence[ProcessSpec], robot: str) -> list[ProcessSpec]:
        """Processes of a graph and the guard; driver and guard join the network of the robot."""
        environment = {SESSION: secrets.token_hex(4)}
        if self.interface:
            address = self.check()
            file = state_folder("robot_network") / f"{self.interface}.xml"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(profile_text(address), encoding="utf-8")
            environment |= {PROFILE_VARIABLE: str(file), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}
        arguments = self.plant, robot, str(self.domain), self.options
        # the guard is optional: without it the graph goes on, and the driver holds the robot instead of damping it
        guard = ProcessSpec(GUARD, (), True, arguments, environment, silence_max=real_robot().guard_kill)
        return [guard, *(replace(spec, environment=environment) if spec == BRIDGE else spec for spec in specs)]
