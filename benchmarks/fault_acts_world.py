"""What the world does to a robot: kicks it, lifts it, stands in its way."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from benchmarks.fault_doing import Act, Doing, pause, unmet
from bridge.closed_loop import ClosedLoop
from controllers.body_outline import BodyOutline
from models.constants import GRAVITY
from models.terrain import terrain_named

KICK_PERIOD, KICK_TIME, KICK_SPEED = 4.0, 0.1, 0.2
"""Time between two kicks, length of each [s], and the velocity that it gives [m/s]."""

HOIST_SPEED, HOIST_TIME, LOWER_SPEED, LOWER_TIME = 0.3, 0.5, 0.05, 5.0
"""Of a crane: up, and down until the feet bear [m/s, s]."""

HANGING_SPEED = 4.0
"""No joint of a lifted robot turns faster once it hangs [rad/s]."""

BOX = "box"
"""Terrain with a box that may be put into the way."""

TURN, FORWARD, FREE_WAY = 0.3, 0.3, 1.0
"""Velocities of a turn [rad/s] and of a walk [m/s], and the way to a box that is free at first [m]."""


def _kick(loop: ClosedLoop) -> Doing:
    """A kick from another side every four seconds."""
    force = loop.robot.mass * KICK_SPEED / KICK_TIME
    for number in range(1000):
        angle = 2.4 * number  # [rad] the golden angle: never the same side
        loop.apply_push((force * np.cos(angle), force * np.sin(angle), 0.0), KICK_TIME)
        yield from pause(loop, KICK_PERIOD)


def _knock_down(loop: ClosedLoop) -> Doing:
    """A push that nothing can take."""
    loop.apply_push((12.0 * loop.robot.mass, 0.0, 0.0), 0.3)
    yield None


def _crane(loop: ClosedLoop, speed: float, duration: float) -> Doing:
    """Move a held robot up [m/s] for a time [s]."""
    for _ in pause(loop, duration):
        loop.data.mocap_pos[0, 2] += speed * loop.plant.period
        yield None


def _lift(loop: ClosedLoop) -> Doing:
    """Lift a robot off a turn on the spot, let it hang, put it down, and have it walk on."""
    loop.set_velocity(0.0, 0.0, TURN)
    yield from pause(loop, 1.5)
    loop.plant.hold(True)
    yield from _crane(loop, HOIST_SPEED, HOIST_TIME)
    steps, fastest = loop.gait.steps, 0.0
    for _ in pause(loop, 1.5):
        fastest = max(fastest, float(np.abs(loop.truth.v[6:]).max()))
        yield None
    if fastest > HANGING_SPEED:
        yield unmet(f"a joint of the lifted robot turns at {fastest:.1f} rad/s")
    for _ in _crane(loop, -LOWER_SPEED, LOWER_TIME):
        yield None
        if loop.plant.load > 0.95 * loop.robot.mass * GRAVITY:
            break
    loop.plant.hold(False)
    yield from pause(loop, 1.0)
    if loop.gait.steps != steps:
        yield unmet(f"the gait took {loop.gait.steps - steps} steps in the air")
    loop.set_velocity(0.0, 0.0, 0.0)  # what was commanded before counts no more
    loop.set_velocity(FORWARD, 0.0, 0.0)
    yield from pause(loop, 2.5)
    if not loop.gait.steps > steps:
        yield unmet("does not walk on")


def _stand_in_the_way(loop: ClosedLoop) -> Doing:
    """A box ahead of a walk; it is taken away later."""
    box = terrain_named(BOX).obstacle
    depth = 0.0 if box is None else box.size[0]
    reach = BodyOutline(loop.robot).reach(np.array([1.0, 0.0]))
    face = float(loop.truth.q[0] + reach) + FREE_WAY
    loop.plant.obstacle.place(face + 0.5 * depth, float(loop.truth.q[1]))
    yield from pause(loop, 6.0)
    left = face - float(loop.truth.q[0] + reach)
    if loop.gait.walking or not 0.1 < left < FREE_WAY:
        yield unmet(f"does not stand before the box: {left:.2f} m are left")
    loop.plant.obstacle.remove()
    yield from pause(loop, 3.5)
    if not loop.gait.walking:
        yield unmet("does not walk on when the way is free")


WORLD: Mapping[str, Act] = {
    "kick": _kick,
    "knock_down": _knock_down,
    "lift": _lift,
    "stand_in_the_way": _stand_in_the_way,
}
"""By the name that a row gives them."""
