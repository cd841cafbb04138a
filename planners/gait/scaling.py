"""Gait of a robot: the reference gait scaled to its legs, within their reach and strength."""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.resources import files
from typing import TypeVar

import numpy as np

from models.config import default_config, overlaid
from models.constants import JOINTS_V
from models.leg_shapes import foot_size
from models.robot_model import RobotModel
from planners.gait.config import (
    GaitConfig,
    PaceConfig,
    ReachConfig,
    RouteConfig,
    StrideConfig,
    SwingConfig,
    TimingConfig,
    VelocityConfig,
)
from planners.gait.strength import within_legs

QUINTIC_PEAK = 15.0 / 8.0  #: Peak over mean speed of a quintic from rest to rest [-]

Part = TypeVar("Part", StrideConfig, PaceConfig, TimingConfig, ReachConfig, VelocityConfig, SwingConfig, RouteConfig)


def load_gait_config(model: RobotModel) -> GaitConfig:
    """Gait of a robot: ``gait_<name>.yaml``, or ``gait.yaml`` scaled to its legs, with the ``laws`` of its profile."""
    return overlaid(
        _packaged(_Robot(repr(replace(model.profile, laws={})), model.description, model)),
        model.profile.laws.get("gait", {}),
        f"{model.profile.source}: laws.gait",
    )


@dataclass(frozen=True, slots=True)
class _Robot:
    """A robot model, which equals another one of the same profile, apart from its ``laws``, and URDF."""

    profile: str
    urdf: str
    model: RobotModel = field(compare=False)


@lru_cache(maxsize=8)
def _packaged(robot: _Robot) -> GaitConfig:
    """Gait without the ``laws`` of the profile; found once per process, since the limits of the legs take 0.2 s."""
    model = robot.model
    own = f"gait_{model.name}"
    if (files("planners") / "config" / f"{own}.yaml").is_file():
        return default_config(GaitConfig, "planners", own)
    config = scaled(default_config(GaitConfig, "planners", "gait"), model.leg_length, foot_size(model))
    fastest = min(config.swing.speed_max, config.swing.speed_share * foot_speed(model))
    config = replace(config, swing=replace(config.swing, speed_max=fastest))
    return within_legs(model, config)


def foot_speed(model: RobotModel) -> float:
    """Mean speed of a swing [m/s]; its peak is the median joint speed limit times the leg length in 'stand'."""
    joints = [joint - JOINTS_V for foot in model.feet for joint in foot.joint_ids_v]
    return float(np.median(model.v_max[joints])) * model.leg_length / QUINTIC_PEAK


def scaled(config: GaitConfig, leg: float, foot: tuple[float, float]) -> GaitConfig:
    """Gait for a leg length and for the length and width of a foot [m].

    Lengths other than widths scale with the leg length, times and speeds with its square root. ``cross_ahead`` and
    ``width_min`` change by the difference in foot length and foot width.
    """
    length, reach = leg / config.leg, config.reach
    time = length**0.5
    return replace(
        config,
        leg=leg,
        foot=foot,
        pace=replace(
            _times(config.pace, time, "forward", "lateral"),
            slow=_stride(config.pace.slow, length, time),
            fast=_stride(config.pace.fast, length, time),
        ),
        timing=_times(config.timing, time, "single_min", "single_urgent", "single_max", "start", "finish"),
        reach=replace(
            _times(reach, length, "forward", "backward", "rise"),
            cross_ahead=reach.cross_ahead + foot[0] - config.foot[0],
            width_min=reach.width_min + foot[1] - config.foot[1],
        ),
        velocity=_times(config.velocity, time, "forward", "backward", "lateral"),
        swing=_times(
            _times(config.swing, length, "edge_clearance"), time, "speed_max", "late_velocity", "trip_landing"
        ),
        route=_times(config.route, time, "forward", "lateral"),
    )


def _stride(stride: StrideConfig, length: float, time: float) -> StrideConfig:
    return _times(_times(stride, length, "crouch", "clearance"), time, "single", "double")


def _times(part: Part, factor: float, *names: str) -> Part:
    """Part with some of its fields multiplied by a factor."""
    return replace(part, **{name: getattr(part, name) * factor for name in names})
