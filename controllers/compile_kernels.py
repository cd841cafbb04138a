"""Compiles the kernels of every law into the cache: `python -m controllers.compile_kernels`, part of the installation.

Each law compiles at construction the kernels of its ticks; here that happens before the first start, in two processes.
Only NumPy, SciPy, numba, Pinocchio and the QP solvers are needed, so that the rest can be installed meanwhile.
"""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pkgutil import resolve_name

from models.numerics.threads import use_one_thread
from models.robot_model import RobotModel

#: What each process builds
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
    """Construct laws, each given as ``module:Class``, for a robot; kernels are the same for every robot."""
    model = RobotModel.load(robot)
    for law in laws:
        resolve_name(law)(model)


def main() -> None:
    """Compile everything."""
    use_one_thread()
    with ProcessPoolExecutor(len(LAWS), mp_context=get_context("spawn")) as pool:
        for _ in pool.map(build, LAWS):
            pass


if __name__ == "__main__":
    main()
