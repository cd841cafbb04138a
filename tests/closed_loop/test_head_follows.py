"""The head of a standing TALOS follows a ball that moves sideways, by what its camera sees of it."""

import ctypes.util
import math

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the extra 'vision' is not installed")

from bridge.closed_loop import ClosedLoop
from bridge.plants.camera import SimulatedCamera
from controllers.vision.gaze import Gaze
from controllers.vision.target_finder import TargetFinder
from models.robot_model import RobotModel
from models.types import Mode

PERIOD = 0.1
"""Between two pictures, and from one to its effect [s]."""


@pytest.mark.slow
@pytest.mark.skipif(ctypes.util.find_library("EGL") is None, reason="EGL is not installed")
def test_the_head_follows_a_ball_that_moves_sideways(talos: RobotModel) -> None:
    loop = ClosedLoop(talos, seed=2, record=False)
    camera, finder, gaze = SimulatedCamera(talos), TargetFinder(), Gaze(talos)
    head = talos.profile.head
    assert head is not None
    joints = [7 + talos.joint_index(name) for name in (head.pan, head.tilt)]
    errors = []
    try:
        for tick in range(80):
            t = PERIOD * tick
            side = 0.9 * math.sin(0.5 * t + 0.6)  # from 15 deg to the side, at up to 0.45 m/s: 13 deg/s
            camera.target = np.array([2.0, side, 1.5 + 0.2 * math.cos(0.5 * t)])
            seen = finder.find(camera.render(loop.truth.q))
            assert seen is not None, f"out of sight at {t:.1f} s"
            bearing = camera.intrinsics.bearing(seen.pixel)
            errors.append(math.acos(min(float(bearing[2]), 1.0)))
            pan, tilt = loop.state.q[joints]
            loop.run(PERIOD)
            loop.look(*gaze.aim(float(pan), float(tilt), bearing))
        assert errors[0] > math.radians(10.0)  # it began elsewhere
        assert max(errors[15:]) < math.radians(8.0)  # and follows, late by the delay and the rounding of its turns
        for _ in range(12):  # the ball rests
            seen = finder.find(camera.render(loop.truth.q))
            assert seen is not None
            bearing = camera.intrinsics.bearing(seen.pixel)
            loop.look(*gaze.aim(*map(float, loop.state.q[joints]), bearing))
            loop.run(PERIOD)
        assert math.acos(min(float(bearing[2]), 1.0)) < math.radians(0.5)
    finally:
        camera.close()
    assert loop.mode is Mode.STAND and not loop.fallen and not loop.faults and loop.foot_slip.max() < 0.002
