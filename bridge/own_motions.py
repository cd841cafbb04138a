"""Motions of the user's own for the graph: the planner reads their files, the supervisor knows their names."""

from __future__ import annotations

from pathlib import Path

from bridge.ros.processes import Parameters
from controllers.supervisor_config import SupervisorConfig
from models.config import default_config
from models.robot_model import RobotModel
from planners.library import load_motion, motion_files


def own_motions(robot: str, folder: Path) -> Parameters:
    """Parameters of the nodes that motions concern.

    Args:
        robot: Profile that the motions are checked against, by name or path.
        folder: Of their files.

    Raises:
        ConfigError: There are none, or one is refused; file and key are named.
    """
    model = RobotModel.load(robot)
    names = [load_motion(file, model).name for file in motion_files(folder)]
    known = default_config(SupervisorConfig, "controllers", "supervisor").motions
    return {
        "motion_planner": {"motions_folder": str(folder.resolve())},
        "supervisor": {"motions": [*known, *(name for name in names if name not in known)]},
    }
