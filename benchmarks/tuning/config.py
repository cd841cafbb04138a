"""Settings of ``poise tune`` (schema of ``benchmarks/config/tune/*.yaml``), and parameters of a robot."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from pydantic.dataclasses import dataclass

from benchmarks.stability.push import PushMode
from controllers.whole_body.config import load_balance_config, load_whole_body_config
from models.config import STRICT, Count, NonNegative, Positive, Proportion, Share, load_config, merged
from models.errors import ConfigError
from models.robot_model import RobotModel
from planners.gait.scaling import load_gait_config

Parameters = dict[str, float]  #: Values by name, such as ``gait.swing.freeze``
Range = tuple[float, float]
Span = tuple[NonNegative, NonNegative]
LOADERS: dict[str, Callable[[RobotModel], Any]] = {
    "gait": load_gait_config,
    "balance": load_balance_config,
    "whole_body": load_whole_body_config,
}
SLOPES = ("up", "up to the left", "down", "up to the right")  #: Sectors of a kind with slopes


@dataclass(frozen=True, slots=True, config=STRICT)
class Kind:
    """Kind of scenarios: a push, or a walk straight ahead, with ranges for uniform random values."""

    push: PushMode | None = None  #: 'catch', 'step' or 'walk' of `poise bench push`; a walk without a push when None
    dv: Span | None = None  #: Impulse over mass of the push [m/s]
    speed: tuple[Positive, Positive] = (0.4, 0.4)  #: Walking speed; no effect on a standing robot [m/s]
    duration: Positive = 10.0  #: Duration of a walk without a push [s]
    count: Count = 1  #: Scenarios per sector in a generation
    tiles: Span | None = None  #: Maximum height of random tiles [m]
    slope: Span | None = None  #: Angle of a plane that rises forward, to the left, backward or to the right [rad]
    friction: tuple[Positive, Positive] | None = None  #: Coulomb coefficient [-]; the robot's coefficient when None
    payload: Span = (0.0, 0.0)  #: Unknown mass at the torso, as a share of the robot's mass [-]
    delay: Span = (0.0, 0.0)  #: Delay added to the delay of sensors and commands [s]
    mass: tuple[Positive, Positive] = (1.0, 1.0)  #: True over modelled mass, for all links [-]
    com: Span = (0.0, 0.0)  #: Horizontal shift of the true CoM, in a random direction [m]
    joint_friction: tuple[Positive, Positive] = (1.0, 1.0)  #: True over modelled dry friction, for all joints [-]
    encoder_offset: Span = (0.0, 0.0)  #: Bound of the random offset of each encoder [rad]

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if isinstance(value, tuple) and value[0] > value[1]:
                raise ValueError(f"{name}: [{value[0]:g}, {value[1]:g}]: lower and upper end are swapped")
        if self.push is PushMode.STAND:
            raise ValueError("push: catch, step or walk expected")
        if (self.push is None) != (self.dv is None):
            raise ValueError("push needs dv, and dv needs push")
        if self.tiles is not None and self.slope is not None:
            raise ValueError("tiles and slope: give one of them only")


@dataclass(frozen=True, slots=True, config=STRICT)
class TuneConfig:
    """Settings of a search; ``benchmarks/config/tune/recovery.yaml`` describes every value."""

    parameters: dict[str, Range]
    scenarios: Annotated[dict[str, Kind], Field(min_length=1)]
    directions: Count
    generations: Count
    population: Annotated[int, Field(ge=4)]
    block: Count
    spread: Share
    tail: Share
    seed: Annotated[int, Field(ge=0)]
    judged: Count
    tolerance: Proportion
    held_out: dict[str, Kind] = Field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.parameters) < 2:
            raise ValueError("parameters: CMA-ES needs two or more")
        for name, (low, high) in self.parameters.items():
            if not low < high:
                raise ValueError(f"parameters: {name}: [{low:g}, {high:g}]: the lower end must be below the upper end")
        if twice := sorted(self.scenarios.keys() & self.held_out.keys()):
            raise ValueError(f"held_out: {twice[0]} is among the scenarios: give it another name")

    @property
    def best(self) -> int:
        """Number of candidates with positive weights in a generation, ``mu`` of CMA-ES."""
        return self.population // 2

    @property
    def kinds(self) -> dict[str, Kind]:
        """All kinds by name, held-out kinds last."""
        return {**self.scenarios, **self.held_out}

    def sectors(self, kind: Kind) -> int:
        """Return the number of sectors: headings of the push, else directions of the slope, else one."""
        return self.directions if kind.push is not None else 1 if kind.slope is None else len(SLOPES)

    def total(self, kinds: dict[str, Kind]) -> int:
        """Return the number of scenarios of some kinds in a generation."""
        return sum(kind.count * self.sectors(kind) for kind in kinds.values())


def load_tune_config(name_or_path: str) -> TuneConfig:
    """Load a packaged search by name, or a file; ``ConfigError`` names file and key."""
    folder = Path(__file__).resolve().parents[1] / "config" / "tune"
    packaged = {path.stem: path for path in sorted(folder.glob("*.yaml"))}
    path = packaged.get(name_or_path, Path(name_or_path))
    if not path.exists() and not path.suffix:
        raise ConfigError(f"unknown search '{name_or_path}'; known: {', '.join(packaged)} (or the path of a YAML file)")
    return load_config(TuneConfig, path)


def present(config: TuneConfig, robot: str) -> Parameters:
    """Return a robot's parameters; ``ConfigError`` for an unknown name, no float, or a value outside of its range."""
    model, found = RobotModel.load(robot), {}
    roots = {root: loader(model) for root, loader in LOADERS.items()}
    for name, (low, high) in config.parameters.items():
        value: Any = roots
        for part in name.split("."):
            known = list(value) if isinstance(value, dict) else list(getattr(type(value), "__dataclass_fields__", ()))
            if part not in known:
                raise ConfigError(f"parameters: {name}: unknown '{part}'; known: {', '.join(known) or 'nothing'}")
            value = value[part] if isinstance(value, dict) else getattr(value, part)
        if not isinstance(value, float):
            raise ConfigError(f"parameters: {name}: expected a floating-point parameter, found {type(value).__name__}")
        if not low <= value <= high:
            raise ConfigError(
                f"parameters: {name}: {value:g} of {robot} is outside [{low:g}, {high:g}]: widen the range"
            )
        found[name] = value
    return found


def laws(parameters: Parameters) -> dict[str, Any]:
    """Convert parameters to nested keys, as in ``laws`` of a profile."""
    nested: dict[str, Any] = {}
    for name, number in parameters.items():
        value: Any = number
        for part in reversed(name.split(".")):
            value = {part: value}
        nested = merged(nested, value)
    return nested
