"""Faults of the simulated sensors and motors: target, kind and times; plans in YAML."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeAlias

from models.config import parse_yaml, read_yaml, refuse_unknown
from models.errors import ConfigError

#: One number, or one for each axis or joint of a target
Numbers: TypeAlias = float | Sequence[float]

#: Valid targets; NAME is a joint
TARGETS = (
    "imu", "imu.gyro", "imu.accel", "joints", "joint:NAME", "torques", "torque:NAME", "feet", "foot:left", "foot:right",
    "joint_states", "stamps", "scan", "motors", "motor:NAME",
)  # fmt: skip

#: Kinds of fault, each with its parameters
PARAMETERS: Mapping[str, tuple[str, ...]] = {
    "off": (),
    "stuck": ("value",),
    "garbage": ("scale",),
    "wrong": ("value", "offset", "scale", "drift"),
    "saturated": ("scale",),
    "slow": ("rate",),
    "delayed": ("delay",),
    "intermittent": ("probability", "period", "share"),
}
STAMP_KINDS = ("stuck", "wrong", "delayed")  #: Kinds for stamps
START, RELEASE = "start", "release"  #: Events at which a plan is injected


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a sensor or a motor; ``docs/faults.md`` lists all targets and kinds.

    ``value``, ``offset``, ``drift`` and ``scale`` are one number, or one for each axis or joint of the target, in the
    units of ``SensorData``; for encoders they refer to positions. Raises ``ConfigError`` for an unknown target or kind,
    and for a parameter that is missing, belongs to another kind, or is out of range.
    """

    target: str  #: One of ``TARGETS``
    kind: str  #: One of ``PARAMETERS``
    start: float = 0.0  #: Begin, relative to the injection [s]
    end: float = math.inf  #: End, relative to the injection [s]
    value: Numbers | None = None  #: Replaces the true value
    offset: Numbers | None = None  #: Added to the true value
    scale: Numbers | None = None  #: Factor on the true value, or on the full scale [-]
    drift: Numbers | None = None  #: Rate of change of the added value, in its unit per second
    #: Delay of the values [s]; until the first one arrives, the value before the fault is repeated
    delay: float | None = None
    rate: float | None = None  #: Rate of new values [Hz]
    probability: float | None = None  #: Probability that a tick is lost, independent of the others [-]
    period: float | None = None  #: Time from one interruption to the next [s]
    share: float | None = None  #: Part of each period, from its begin, that is lost [-]; 0.5 by default

    def __post_init__(self) -> None:
        if self.pattern not in TARGETS:
            raise ConfigError(f"fault: unknown target '{self.target}'; known: {', '.join(TARGETS)}")
        if self.kind not in PARAMETERS:
            raise ConfigError(f"fault of {self.target}: unknown kind '{self.kind}'; known: {', '.join(PARAMETERS)}")
        if self.target == "stamps" and self.kind not in STAMP_KINDS:
            raise ConfigError(f"fault of stamps: kind '{self.kind}' is not possible; known: {', '.join(STAMP_KINDS)}")
        own = PARAMETERS[self.kind]
        for name in [field.name for field in fields(self)][2:]:
            given = getattr(self, name)
            if given is None:
                continue
            if name not in ("start", "end", *own):
                raise self._refusal(name, f"not a parameter of this kind; known: {', '.join(('start', 'end', *own))}")
            self._check(name, given)
        for name, refused, why in self._rules(own):
            if refused:
                raise self._refusal(name, why)

    @property
    def pattern(self) -> str:
        """The target with the joint's name replaced by NAME."""
        group, colon, name = self.target.partition(":")
        return f"{group}:NAME" if colon and group != "foot" and name else self.target

    @property
    def joint(self) -> str:
        """Name of the target joint; empty for other targets."""
        return self.target.partition(":")[2] if self.pattern.endswith(":NAME") else ""

    @property
    def is_motor(self) -> bool:
        """Whether the target is a motor, not a sensor."""
        return self.target.startswith("motor")

    def __str__(self) -> str:
        words = [f"{name} {getattr(self, name)}" for name in PARAMETERS[self.kind] if getattr(self, name) is not None]
        when = [f"from {self.start:g} s"] if self.start else []
        when += [f"until {self.end:g} s"] if self.end < math.inf else []
        return f"{self.target} {self.kind}" + (f" ({', '.join(words + when)})" if words + when else "")

    def _refusal(self, name: str, why: str) -> ConfigError:
        return ConfigError(f"fault {self.target} {self.kind}: {name}: {why}")

    def _check(self, name: str, given: Any) -> None:
        several = name in ("value", "offset", "scale", "drift")
        items = list(given) if several and isinstance(given, Sequence) and not isinstance(given, str) else [given]
        bounded = self.is_motor or self.target == "stamps"
        for item in items:
            if isinstance(item, bool) or not isinstance(item, int | float):
                raise self._refusal(name, f"{item!r} is not a number")
            finite = math.isfinite(item)
            if not finite and not (name == "end" and item == math.inf) and (name != "value" or bounded):
                raise self._refusal(name, f"{item} is not finite")
            if name in ("probability", "share") and not 0.0 < item <= 1.0:
                raise self._refusal(name, f"{item} is not in (0, 1]")
            if name in ("delay", "rate", "period") and item <= 0.0:
                raise self._refusal(name, f"{item} is not positive")
        if self.kind in ("garbage", "saturated") and name == "scale" and any(item < 0.0 for item in items):
            raise self._refusal(name, f"{given} is negative")

    def _rules(self, own: tuple[str, ...]) -> Iterator[tuple[str, bool, str]]:
        """Rules between the parameters: name, whether it is violated, reason."""
        given = {name for name in own if getattr(self, name) is not None}
        yield "start", self.start < 0.0, f"{self.start} s is before the injection"
        yield "end", not self.start < self.end, f"{self.end} s is not after the start at {self.start} s"
        if self.kind in ("slow", "delayed"):
            yield own[0], not given, "missing"
        if self.kind == "wrong":
            refused = ("value" in given) == bool(given - {"value"})
            yield "value", refused, "give either value, or some of offset, scale and drift"
        if self.kind == "intermittent":
            yield "probability", ("probability" in given) == ("period" in given), "give either probability or period"
            yield "share", "share" in given and "period" not in given, "needs period"


@dataclass(frozen=True, slots=True)
class FaultPlan:
    """Faults injected together, at the 'release' of the robot or at its 'start', before sensors are averaged."""

    faults: tuple[Fault, ...]
    since: str = RELEASE

    def __post_init__(self) -> None:
        if self.since not in (START, RELEASE):
            raise ConfigError(f"fault plan: since: unknown '{self.since}'; known: {START}, {RELEASE}")

    def __str__(self) -> str:
        return "; ".join(map(str, self.faults)) or "no faults"


#: All forms of a plan: faults, YAML, the path of a YAML file, or the name of a packaged scenario. Empty text means
#: no faults.
Faults: TypeAlias = Fault | FaultPlan | Sequence[Fault] | str | Path


def scenario_names() -> list[str]:
    """Names of the packaged scenarios, ``bridge/config/faults/*.yaml``."""
    return sorted(path.stem for path in _folder().glob("*.yaml"))


def fault_plan(faults: Faults | None) -> FaultPlan:
    """Make a plan from any form of ``Faults``.

    YAML is a mapping ``{since: release, faults: [{target: imu, kind: off, end: 0.02}, ...]}``, only its list, or only
    one fault. Raises ``ConfigError`` with the cause and the valid names.
    """
    if faults is None:
        return FaultPlan(())
    if isinstance(faults, FaultPlan):
        return faults
    if isinstance(faults, Fault):
        return FaultPlan((faults,))
    if isinstance(faults, str | Path):
        return _read(faults)
    return FaultPlan(tuple(faults))


def _folder() -> Path:
    return Path(str(files("bridge"))) / "config" / "faults"


def _read(given: str | Path) -> FaultPlan:
    text = str(given).strip()
    if not text:
        return FaultPlan(())
    inline = isinstance(given, str) and (text[:1] in ("{", "[", "-") or "\n" in text or ": " in text)
    if inline:
        listed = {"[": "faults: ", "-": "faults:\n"}.get(text[0], "")
        return _parse(parse_yaml(listed + text, "faults"), "faults")
    if text in scenario_names():
        return _parse(read_yaml(_folder() / f"{text}.yaml"), text)
    if not Path(text).suffix and not Path(text).exists():
        raise ConfigError(f"faults: unknown scenario '{text}'; known: {', '.join(scenario_names())}; or give a file")
    return _parse(read_yaml(Path(text)), text)


def _parse(data: dict[str, Any], source: str) -> FaultPlan:
    if "target" in data or "kind" in data:
        data = {"faults": [data]}
    refuse_unknown(data, ("since", "faults"), source)
    listed = data.get("faults")
    if not isinstance(listed, list):
        raise ConfigError(f"{source}: faults: expected a list of faults")
    return FaultPlan(tuple(_fault(item, f"{source}[{i}]") for i, item in enumerate(listed)), data.get("since", RELEASE))


def _fault(item: object, source: str) -> Fault:
    if not isinstance(item, dict):
        raise ConfigError(f"{source}: expected a mapping of keys, found {type(item).__name__}")
    refuse_unknown(item, [field.name for field in fields(Fault)], source)
    for key in ("target", "kind"):
        if key not in item:
            raise ConfigError(f"{source}: {key}: missing")
    given: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in item.items()}
    kind = "off" if given["kind"] is False else str(given["kind"])  # YAML takes an unquoted off for false
    try:
        return Fault(**{**given, "target": str(given["target"]), "kind": kind})
    except ConfigError as error:
        raise ConfigError(f"{source}: {error}") from error
