"""Parameters of the bridge's node."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bridge.loop_config import LoopConfig
from bridge.mujoco_world import Place
from models.config import default_config
from models.errors import ConfigError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.parameters import describe
from models.terrain import FLAT


@dataclass(frozen=True, slots=True)
class BridgeParameters:
    """What was asked for when the node was started.

    Attributes:
        config: Times and tolerances of the start.
        lockstep: Whether the plant waits for the command of each tick.
        seed: Of the sensor noise.
        sensor_noise: Whether there is noise.
        sensor_errors: Errors of the sensors on purpose: a file or YAML; empty for none.
        faults: Faults of sensors and motors from the release on: as ``fault_plan`` reads them; empty for none.
        terrain: Name of the ground.
        payload: Mass unknown to the laws [kg].
        slow_rate: Rate of ``/clock`` and ``/ground_truth/odom`` [Hz].
        max_age: Age of the sensors a command answers above which it is refused [ns].
        latency_file: Where the latencies go; empty for nowhere.
        speed: Simulated over real time, where nobody waits for anybody.
        place: Where the robot begins, in a world of several.
        sensor_rate: Rate at which the sensors are published [Hz]; drivers and physics go on at their own.
    """

    config: LoopConfig
    lockstep: bool
    seed: int
    sensor_noise: bool
    sensor_errors: str
    faults: str
    terrain: str
    payload: float
    slow_rate: float
    max_age: int
    latency_file: str
    speed: float
    place: Place
    sensor_rate: float


def declare(node: PoiseNode) -> BridgeParameters:
    """Declare every parameter and read it."""

    def get(name: str, default: Any, text: str, **bounds: Any) -> Any:
        return node.declare_parameter(name, default, describe(text, **bounds)).value

    config = default_config(LoopConfig, "bridge", "closed_loop")
    place = "Where the robot begins in a world of several: x [m], y [m], heading [rad]"
    age = "Age of the sensors a command answers above which it is refused [s]"
    return BridgeParameters(
        config=config,
        lockstep=topics.declare_lockstep(node),
        seed=int(get("seed", 0, "Seed of the sensor noise", integer=(0, 2**63 - 1))),
        sensor_noise=bool(get("sensor_noise", True, "Noise, bias and quantisation of the profile")),
        sensor_errors=str(get("sensor_errors", "", "Further errors of the sensors: a file, or YAML; empty for none")),
        faults=str(get("faults.plan", "", "Faults from the release on: a file, a scenario, or YAML; empty for none")),
        terrain=str(get("terrain", FLAT, "Ground: a name of models/config/terrain.yaml, or flat")),
        payload=float(get("payload", 0.0, "Mass unknown to the laws [kg]", low=0.0, high=100.0)),
        slow_rate=float(get("slow_rate", 100.0, "Rate of /clock and /ground_truth/odom [Hz]", low=1.0, high=1000.0)),
        max_age=round(NANOSECONDS * float(get("max_command_age", config.max_command_age, age, low=0.001, high=1.0))),
        latency_file=str(get("latency_file", "", "Where to write the latencies; empty for none")),
        speed=float(get("speed", 1.0, "Simulated over real time, without lockstep", low=0.01, high=1.0)),
        place=Place(*_three(get("place", [0.0, 0.0, 0.0], place))),
        sensor_rate=float(get("sensor_rate", 1000.0, "Rate of the sensors' topics [Hz]", low=100.0, high=1000.0)),
    )


def _three(place: Sequence[float]) -> Sequence[float]:
    if len(place) != 3:
        raise ConfigError(f"place: {len(place)} numbers instead of x, y and heading")
    return place
