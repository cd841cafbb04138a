"""The gait of a robot: its own, or that of the reference leg scaled to its legs."""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pinocchio as pin

from models.config import default_config
from models.robot_model import RobotModel
from planners.gait.config import GaitConfig

QUINTIC_PEAK = 15.0 / 8.0
"""Peak over mean speed of a quintic from rest to rest [-]."""


def load_gait_config(model: RobotModel) -> GaitConfig:
    """The packaged gait of a robot: ``gait_<name>.yaml``, or ``gait.yaml`` scaled to its legs."""
    own = f"gait_{model.name}"
    if (files("planners") / "config" / f"{own}.yaml").is_file():
        return default_config(GaitConfig, "planners", own)
    config = scaled(default_config(GaitConfig, "planners", "gait"), leg_length(model))
    fastest = min(config.swing.speed_max, config.swing.speed_share * foot_speed(model))
    return replace(config, swing=replace(config.swing, speed_max=fastest))


def foot_speed(model: RobotModel) -> float:
    """Mean speed of a swing whose peak takes a leg as long as in 'stand' at the median of its joints' limits [m/s]."""
    joints = [joint - 6 for foot in model.feet for joint in foot.joint_ids_v]
    return float(np.median(model.v_max[joints])) * leg_length(model) / QUINTIC_PEAK


def leg_length(model: RobotModel) -> float:
    """Height of the hips above the soles in the 'stand' posture [m]."""
    data = model.data()
    pin.forwardKinematics(model.pin, data, model.standing_configuration())
    hip = model.pin.supports[model.pin.frames[model.feet[0].frame_id].parentJoint][2]
    return float(data.oMi[hip].translation[2])


def scaled(config: GaitConfig, leg: float) -> GaitConfig:
    """The gait of a robot with legs of another length: lengths scale with it, times with its root.

    Speeds scale with the root too, widths stay: they are set by hips and soles, not by the leg's length.
    """
    length = leg / config.leg
    time = length**0.5
    timing, reach, velocity, swing = config.timing, config.reach, config.velocity, config.swing
    route = config.route
    return replace(
        config,
        leg=leg,
        crouch=config.crouch * length,
        timing=replace(
            timing,
            single=timing.single * time,
            single_min=timing.single_min * time,
            single_urgent=timing.single_urgent * time,
            single_max=timing.single_max * time,
            double=timing.double * time,
            start=timing.start * time,
            finish=timing.finish * time,
        ),
        reach=replace(reach, forward=reach.forward * length, backward=reach.backward * length),
        velocity=replace(
            velocity,
            forward=velocity.forward * time,
            backward=velocity.backward * time,
            lateral=velocity.lateral * time,
        ),
        swing=replace(
            swing,
            clearance=swing.clearance * length,
            speed_max=swing.speed_max * time,
            late_velocity=swing.late_velocity * time,
            rise_max=swing.rise_max * length,
        ),
        route=replace(route, forward=route.forward * time, lateral=route.lateral * time),
    )
