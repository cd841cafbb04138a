"""Types built here under the names of official ones have their hashes, so that MoveIt and RViz take them for those."""

import ctypes

import pytest

from models.errors import MessageError
from models.nodes.interfaces import interface

pytestmark = pytest.mark.ros

OFFICIAL = {
    "control_msgs/action/FollowJointTrajectory": "738ebcb7a2d7cfa42f9f1001cc99ce3a4383d1cfe508015d9be8485e4b1c66f6",
    "control_msgs/action/FollowJointTrajectory_SendGoal": (
        "b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f"
    ),
    "control_msgs/action/FollowJointTrajectory_GetResult": (
        "e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b"
    ),
    "control_msgs/action/FollowJointTrajectory_FeedbackMessage": (
        "80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71"
    ),
    "control_msgs/msg/JointTolerance": "c254f9cece0f3b733017b6990fd46d1326e25242d6b8844398c97d9a88e7d648",
    "control_msgs/msg/JointComponentTolerance": "739ea7566931944d33830fa10f1bf5e7a7fbdc3172bce7a7eaac642bd6e3ffa4",
    "tf2_msgs/msg/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
}
"""REP-2011 hashes (RIHS01) by type.

control_msgs: generated from the definitions of its jazzy branch (5.8.0) by rosidl of Jazzy, and the same in a public
colcon workspace (saahu27/aprs, ``build/control_msgs/rosidl_generator_c``). tf2_msgs: from geometry2's jazzy branch, and
as ``ros2 topic info -v /tf`` prints it on other people's robots (RobotWebTools/rosbridge_suite, issue 1282).
"""


class Hash(ctypes.Structure):
    """``rosidl_type_hash_t``."""

    _fields_ = (("version", ctypes.c_uint8), ("value", ctypes.c_uint8 * 32))


@pytest.mark.parametrize("name", OFFICIAL)
def test_the_hash_is_the_official_one(name: str) -> None:
    package, kind, kind_name = name.split("/")
    try:
        interface(package, kind, kind_name.split("_")[0])
    except MessageError as error:
        pytest.skip(str(error))
    library = ctypes.CDLL(f"lib{package}__rosidl_generator_c.so")  # loaded with the type, here or in a sourced ROS 2
    hash_of = getattr(library, f"{name.replace('/', '__')}__get_type_hash")
    hash_of.restype = ctypes.POINTER(Hash)
    found = hash_of(None).contents
    assert (found.version, bytes(found.value).hex()) == (1, OFFICIAL[name])
