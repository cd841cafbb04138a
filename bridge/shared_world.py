"""Several robots in one world, in one process, without ROS, in lockstep."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bridge.closed_loop import ClosedLoop
from bridge.plants.mujoco import step_world
from bridge.plants.world import MujocoWorld, Place
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.terrain import FLAT, Terrain

#: Options of ``ClosedLoop`` for one robot only: several robots would write one file or share the state of a law
OF_ONE = ("calibration", "controller", "mcap")


class SharedWorld:
    """A ``ClosedLoop`` for each robot, all in one ``MujocoWorld``.

    In a tick, the laws of every robot process the sensors of that robot; then the physics advances once. The loops
    start one after the other. ``step`` or ``run`` of one loop advances only that robot; the others are frozen.

    Each robot gets the next seed. ``options`` are passed to every ``ClosedLoop``; those in ``OF_ONE`` need a single
    robot. The other arguments are those of ``MujocoWorld``. Raises ``ConfigError`` and ``PoiseError`` as both classes.
    """

    def __init__(
        self,
        robots: Mapping[str, str | Path | RobotModel],
        places: Mapping[str, Place] | None = None,
        *,
        seed: int = 0,
        terrain: str | Terrain = FLAT,
        friction: float | None = None,
        timestep: float = 0.001,
        visuals: bool = False,
        **options: Any,
    ) -> None:
        for option in OF_ONE:
            if options.get(option) is not None and len(robots) > 1:
                raise ConfigError(f"{option}: for a single robot only; this world has several")
        models = {
            name: each if isinstance(each, RobotModel) else RobotModel.load(each) for name, each in robots.items()
        }
        self.world = MujocoWorld(models, places, friction=friction, terrain=terrain, timestep=timestep, visuals=visuals)
        self.loops = {
            name: ClosedLoop(model, seed + number, world=self.world, name=name, **options)
            for number, (name, model) in enumerate(models.items())
        }

    def __getitem__(self, name: str) -> ClosedLoop:
        """The loop of a robot; ``ConfigError`` for an unknown name."""
        if name not in self.loops:
            raise ConfigError(f"world: unknown robot '{name}'; known: {', '.join(self.loops)}")
        return self.loops[name]

    def step(self) -> None:
        """Run one tick of all robots."""
        loops = self.loops.values()
        for loop in loops:
            loop.before_physics()
        step_world(self.world, [loop.plant for loop in loops])
        for loop in loops:
            loop.after_physics()

    def run(self, duration: float) -> None:
        """Run for a simulated time [s], rounded to ticks; ``ConfigError`` when it is negative or not finite."""
        if not 0.0 <= duration < float("inf"):
            raise ConfigError(f"duration: {duration} s is negative or not finite")
        for _ in range(round(duration / self.world.period)):
            self.step()
