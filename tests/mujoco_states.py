"""The robots in MuJoCo, and states to put them in."""

from functools import cache

import mujoco
import numpy as np

from models.mujoco_model import MujocoModel, build_mujoco, pin_to_mujoco
from models.robot_model import RobotModel


@cache
def built(robot: RobotModel) -> MujocoModel:
    """The robot as it is packaged, built once."""
    return build_mujoco(robot)


def random_state(robot: RobotModel, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Configuration and velocity anywhere above the floor, in Pinocchio's order."""
    rng = np.random.default_rng(seed)
    quaternion = rng.normal(size=4)
    position = rng.uniform(-2.0, 2.0, size=3) + np.array([0.0, 0.0, 3.0])  # clear of the floor
    joints = rng.uniform(robot.q_lower, robot.q_upper)
    q = np.concatenate([position, quaternion / np.linalg.norm(quaternion), joints])
    return q, rng.normal(size=robot.nv)


def placed(robot: RobotModel, mj: MujocoModel, q: np.ndarray, v: np.ndarray) -> mujoco.MjData:
    """The simulation in a state."""
    data = mujoco.MjData(mj.model)
    data.qpos[:], data.qvel[:] = pin_to_mujoco(robot, mj, q, v)
    mujoco.mj_forward(mj.model, data)
    return data
