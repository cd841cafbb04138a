"""Drivers and laws behind Booster's protocol against the robot's side in one process, in lockstep."""

from functools import partial
from pathlib import Path
from typing import Any

from bridge.hardware_loop import PlantLoop
from bridge.plants.booster.guard import BoosterGuard
from bridge.plants.booster.plant import BoosterPlant
from models.robot_model import RobotModel
from tests.booster.simulated import BoosterRobot, DirectBoosterLink


class BoosterLoop(PlantLoop[BoosterRobot, DirectBoosterLink, BoosterPlant, BoosterGuard]):
    """A robot behind Booster's protocol.

    Args:
        marker: File that marks an unfinished run.
        laws: Profile of the laws and drivers, by name or path.
        robot: Profile of the simulated robot.
        seed: Of the sensor noise.
        delay: From a state to its command in force [ms].
        settings: Options of the plant, as in ``bridge/config/booster.yaml``.
    """

    def __init__(
        self, marker: Path, *, laws: str | Path, robot: str | Path, seed: int = 0, delay: int = 2, **settings: Any
    ) -> None:
        side = BoosterRobot(str(robot), settings=settings, seed=seed)
        link, model = DirectBoosterLink(side, delay), RobotModel.load(laws)
        make_plant = partial(BoosterPlant, model, marker=str(marker), link=link, **settings)
        super().__init__(marker, model, side, link, make_plant, partial(BoosterGuard, model, settings))
        link.receivers.append(self._hear)
