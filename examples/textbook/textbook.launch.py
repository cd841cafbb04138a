"""Starts three textbook nodes for one robot; namespace:=robot_1 for one of several."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration

HERE = Path(__file__).parent
NODES = ("humanoid_controller", "imu_logger", "text_commander")


def generate_launch_description():
    namespace = ["__ns:=/", LaunchConfiguration("namespace")]
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value=""),
            *(
                ExecuteProcess(
                    cmd=["python3", str(HERE / f"{name}.py"), "--ros-args", "-r", namespace], output="screen"
                )
                for name in NODES
            ),
        ]
    )
