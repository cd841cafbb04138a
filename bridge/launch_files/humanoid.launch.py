"""``ros2 launch bridge humanoid.launch.py robot:=talos``: runs ``poise up`` from a sourced ROS 2.

``poise up`` starts, configures, activates, supervises and ends the other processes. This file imports no module of
poise, because ``ros2`` may use another Python.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

#: Executable under the install prefix of this file, in ``lib`` beside ``share``
POISE = Path(__file__).resolve().parents[3] / "lib" / "bridge" / "poise"
#: Default and description of each launch argument
ARGUMENTS: Mapping[str, tuple[str, str]] = {
    "robot": ("g1", "Robot profile, by name or path"),
    "namespace": ("", "Namespace of every node, topic and service; empty for none"),
    "robots": ("", "Several robots in one world, by namespace, such as robot_1=g1,robot_2=talos; empty for one"),
    "speed": ("1.0", "Ratio of simulated to real time"),
    "terrain": ("flat", "Ground: a name of models/config/terrain.yaml"),
    "expected_friction": ("0.0", "Expected friction coefficient of the ground; 0 for that of the profile"),
    "lockstep": ("false", "Whether the plant waits for the command of every tick"),
    "network": ("false", "Whether to communicate with other machines; otherwise loopback only"),
    "plant": ("mujoco", "Plant: mujoco, unitree, booster, ros2_control, an installed plant, or module:Class"),
    "plant_options": ("", "Options of another plant than mujoco: YAML in braces, or a file"),
    "network_interface": ("", "Network interface to a real robot"),
    "robot_domain": ("", "DDS domain of a real robot; that of plant_options, or 0, where empty"),
    "camera": ("false", "Whether to render the robot's camera, in a separate process"),
    "params_file": ("", "ROS parameter file: further parameters of the nodes, NODE: {ros__parameters: {NAME: VALUE}}"),
    "given_map": ("", "Prior map of the ground: a YAML file, as poise map writes it"),
    "terrain_map": ("false", "Whether to cast depth camera and lidar, and map the ground, in three separate processes"),
}
FLAGS = ("lockstep", "network", "camera", "terrain_map")

END_TIME = "15.0"  #: Time for ``poise up`` to end [s]; it waits up to 9 s for its processes


def command(given: Mapping[str, str]) -> list[str]:
    """Command line of ``poise up`` from the values of the launch arguments; empty ones are omitted.

    ``ValueError`` names an invalid flag.
    """
    line = [str(POISE), "up"]
    for name, value in given.items():
        if name not in FLAGS:
            line += [f"--{name.replace('_', '-')}", value] if value else []
        elif value.lower() not in ("true", "false"):
            raise ValueError(f"{name}: '{value}' is neither true nor false")
        elif value.lower() == "true":
            line.append(f"--{name.replace('_', '-')}")
    return line


def generate_launch_description() -> Any:
    """Entry point of ``ros2 launch``."""
    from launch import LaunchDescription
    from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
    from launch.substitutions import LaunchConfiguration

    def start(context: Any) -> list[Any]:
        given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
        end = Shutdown(reason="poise up has ended")
        return [ExecuteProcess(cmd=command(given), output="screen", sigterm_timeout=END_TIME, on_exit=end)]

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])
