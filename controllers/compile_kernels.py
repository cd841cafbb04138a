"""Compiles the kernels of every law into the cache: `python -m controllers.compile_kernels`, part of the installation.

Each law compiles its kernels at construction. This module constructs all laws before the first start, in two processes.
It needs only NumPy, SciPy, numba, Pinocchio and the QP solvers, so the other packages can be installed meanwhile.
"""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pkgutil import resolve_name

from models.numerics.threads import use_one_thread
from models.robot_model import RobotModel

#: Laws that each process constructs
LAWS = (
    ("controllers.balance.controller:BalanceController",),
    (
        "controllers.estimation.estimator:StateEstimator",
        "planners.gait.planner:GaitPlanner",
        "controllers.safety.joint_monitor:JointMonitor",
        "planners.terrain.mapper:TerrainMapper",
    ),
)


def build(laws: tuple[str, ...], robot: str = "g1") -> None:
    """Construct laws, each given as ``module:Class``, for one robot; the kernels do not depend on the robot."""
    model = RobotModel.load(robot)
    for law in laws:
        resolve_name(law)(model)


def main() -> None:
    """Compile the kernels of all laws."""
    use_one_thread()
    with ProcessPoolExecutor(len(LAWS), mp_context=get_context("spawn")) as pool:
        for _ in pool.map(build, LAWS):
            pass


if __name__ == "__main__":
    main()
