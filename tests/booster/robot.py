"""A robot with the joints of Booster's T1: the body of a G1 with joints fixed and renamed, and a head that turns.

A model of the T1 is not part of this project. The legs of this one hang from its floating base; those of the T1 hang
from a waist joint below it.
"""

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import yaml

from models.robot_model import RobotModel

_SIDES = ("left", "right")
#: Name in Booster's order of motors by that of the G1
NAMES = {
    "waist_yaw_joint": "Waist",
    **{
        f"{side}_{old}_joint": f"{side.capitalize()}_{new}"
        for side in _SIDES
        for old, new in {
            "shoulder_pitch": "Shoulder_Pitch", "shoulder_roll": "Shoulder_Roll", "shoulder_yaw": "Elbow_Pitch",
            "elbow": "Elbow_Yaw", "hip_pitch": "Hip_Pitch", "hip_roll": "Hip_Roll", "hip_yaw": "Hip_Yaw",
            "knee": "Knee_Pitch", "ankle_pitch": "Ankle_Pitch", "ankle_roll": "Ankle_Roll",
        }.items()
    },
}  # fmt: skip
HEAD = ("AAHead_yaw", "Head_pitch")
_LINK = (
    '<link name="{name}"><inertial><origin xyz="0 0 0.05"/><mass value="0.3"/>'
    '<inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
_JOINT = (
    '<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}"/>'
    '<axis xyz="{axis}"/><limit lower="-1" upper="1" effort="7" velocity="12"/></joint>'
)
HARDWARE = {
    "motor_temperature": {"warn": 75.0, "hold": 90.0, "damp": 105.0},
    "lost_packets": {"warn": 0.02, "hold": 0.1, "damp": 0.5},
    "torque_saturation": {"warn": 0.2, "hold": 0.5, "damp": 0.95},
    "saturation": 0.98,
    "foreign_commands": {"warn": 0.5, "hold": 0.5, "damp": 10.0},
    "motor_error": "hold",
    "stop_buttons": ["back"],
    "persistence": 0.1,
}


def write_profiles(folder: Path) -> tuple[Path, Path]:
    """Write the URDF and two profiles: of the simulated robot, and of the laws, without foot sensors."""
    g1 = RobotModel.load("g1")
    root = ET.parse(g1.urdf).getroot()
    for joint in root.iter("joint"):
        name = joint.get("name", "")
        if name in NAMES:
            joint.set("name", NAMES[name])
        elif name in g1.joint_names:
            joint.set("type", "fixed")
    places = {"neck": ("torso_link", "0 0 0.4", "0 0 1"), "face": ("neck", "0 0 0.02", "0 1 0")}
    for name, (child, (parent, xyz, axis)) in zip(HEAD, places.items(), strict=True):
        root.append(ET.fromstring(_LINK.format(name=child)))
        root.append(ET.fromstring(_JOINT.format(name=name, parent=parent, child=child, xyz=xyz, axis=axis)))
    urdf = folder / "robot.urdf"
    ET.ElementTree(root).write(urdf)
    assert g1.profile.source
    profile: dict[str, Any] = yaml.safe_load(Path(g1.profile.source).read_text(encoding="utf-8"))
    profile |= {"name": "t1_joints", "urdf": str(urdf)}
    profile["joints"] = {
        NAMES[name]: {**values, "aliases": []} for name, values in profile["joints"].items() if name in NAMES
    }
    profile["joints"] |= {name: {"motor": "unitree_4010"} for name in HEAD}
    profile["postures"] = {
        name: {NAMES[joint]: value for joint, value in posture.items() if joint in NAMES}
        for name, posture in profile["postures"].items()
    }
    robot, laws = folder / "t1_joints.yaml", folder / "t1_joints_hardware.yaml"
    robot.write_text(yaml.safe_dump(profile, sort_keys=False), encoding="utf-8")
    over = {
        "extends": str(robot), "name": "t1_joints_hardware", "hardware": HARDWARE,
        "sensors": {"feet": {"fitted": False}, "scan": None, "camera": None},
    }  # fmt: skip
    laws.write_text(yaml.safe_dump(over, sort_keys=False), encoding="utf-8")
    return robot, laws
