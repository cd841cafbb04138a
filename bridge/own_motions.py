"""User-defined motions for the graph: files for the planner, names for the supervisor."""

from __future__ import annotations

from pathlib import Path

from bridge.ros.processes import Parameters
from controllers.safety.supervisor_config import SupervisorConfig
from models.config import default_config
from models.robot_model import RobotModel
from planners.library import load_motion, motion_files


def own_motions(robot: str, folder: Path) -> Parameters:
    """Node parameters for a folder of motion files; ``ConfigError`` when empty, or with file and key of an error."""
    model = RobotModel.load(robot)
    names = [load_motion(file, model).name for file in motion_files(folder)]
    known = default_config(SupervisorConfig, "controllers", "supervisor").motions
    return {
        "motion_planner": {"motions_folder": str(folder.resolve())},
        "supervisor": {"motions": [*known, *(name for name in names if name not in known)]},
    }
