"""Acts of fault rows: invalid trajectories, commands in a wrong state, disturbances, solver faults."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, TypeAlias
from unittest.mock import patch

import numpy as np
from msgspec import structs

from bridge.closed_loop import ClosedLoop
from bridge.plants.fault_plan import Fault
from controllers.balance.controller import BalanceController
from controllers.commands.arbitration import Arbiter
from controllers.commands.command_signature import KEY_BYTES, Signer, Verifier
from controllers.commands.obstacle_stop import BodyOutline
from controllers.qp.active_set import QP
from controllers.whole_body.problem import QPBuilder
from models.constants import GRAVITY, NANOSECONDS
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.terrain import terrain_named
from models.types import CommandReply, ControlResult, JointTrajectory, Matrix, Mode

#: Steps of an act, one before each tick; each yields the reply to a command, if any
Steps: TypeAlias = Iterator[CommandReply | None]
Act: TypeAlias = Callable[[ClosedLoop], Steps]  # disturbance or command of a row


def attempt(request: Callable[[], object]) -> CommandReply:
    """Make a request and return the reply; a ``PoiseError`` becomes a refusal with its text."""
    try:
        request()
    except PoiseError as error:
        return CommandReply(False, str(error))
    return CommandReply(True, "done")


def failure(reason: str) -> CommandReply:
    """Return a refusal; it fails a row that expects none."""
    return CommandReply(False, reason)


def pause(loop: ClosedLoop, duration: float) -> Steps:
    """Wait for a time [s]."""
    for _ in range(round(duration / loop.plant.period)):
        yield None


def commands(*texts: str) -> Act:
    """Return an act that sends text commands, one per tick."""

    def act(loop: ClosedLoop) -> Steps:
        for text in texts:
            yield loop.command(text)

    return act


def once(do: Callable[[ClosedLoop], CommandReply | None]) -> Act:
    """Return an act with one step, whose result is the reply."""

    def act(loop: ClosedLoop) -> Steps:
        yield do(loop)

    return act


#: Returns the fields that make a trajectory invalid, given a trajectory that holds the posture
Corruption = Callable[[JointTrajectory, RobotModel], dict[str, Any]]


def _wrong(corrupt: Corruption) -> Act:
    def act(loop: ClosedLoop) -> Steps:
        posture = loop.controller.reference.posture
        held = JointTrajectory(loop.robot.joint_names, np.array([0.5, 1.0]), np.array([posture, posture]))
        wrong = replace(held, **corrupt(held, loop.robot))
        for accept in (loop.controller.follow, lambda given: loop.drivers.command_trajectory(given, loop.t)):
            reply = attempt(lambda: accept(wrong))  # noqa: B023  # called at once
            if reply.accepted:
                yield failure("executed")
                return
        yield reply

    return act


def _with(values: Matrix, points: int | slice, value: float) -> Matrix:
    """Return a copy of (n, nj) with a value set for the first joint at some points."""
    changed = values.copy()
    changed[points, 0] = value
    return changed


def _points(count: int) -> Corruption:
    return lambda held, robot: {
        "times": 1.0 + np.arange(count, dtype=np.float64),
        "positions": np.tile(held.positions[:1], (count, 1)),
    }


def _times(*times: float) -> Corruption:
    return lambda held, robot: {"times": np.array(times)}


#: Wall time at the start of the simulation, and tolerance for stamps of signed commands [s]
WALL_TIME, WINDOW = 1.7e9, 0.1
KEY, OTHER_KEY = bytes(KEY_BYTES), bytes([1]) * KEY_BYTES

PATIENCE = 0.2  # maximum time until a robot damps [s]


def _velocity(forward: float) -> Act:
    return once(lambda loop: attempt(lambda: loop.set_velocity(forward, 0.0, 0.0)))


def _stand_in_walk(loop: ClosedLoop) -> Steps:
    """Command stand while walking: the robot may enter stand only between two steps."""
    yield loop.command("stand")
    while loop.mode is Mode.WALK:
        yield None
    if loop.gait.walking:
        yield failure("mode stand was entered during a step")


def _walk_damped(loop: ClosedLoop) -> Steps:
    loop.inject(Fault("joint_states", "off", end=PATIENCE))
    yield from pause(loop, 2.0 * PATIENCE)
    yield loop.command("walk")


def _stand_fallen(loop: ClosedLoop) -> Steps:
    _knock_down(loop)
    yield from pause(loop, 1.5)
    yield loop.command("stand")


def _flood(loop: ClosedLoop) -> Steps:
    for _ in range(1000):
        for _ in range(10):
            loop.command("nonsense")
        yield None


def _signed(lines: Callable[[Callable[[], int]], tuple[str, ...]]) -> Act:
    """Send lines to a robot that accepts only signed commands; ``lines`` receives the wall clock [ns]."""

    def act(loop: ClosedLoop) -> Steps:
        def clock() -> int:
            return round((WALL_TIME + loop.t) * NANOSECONDS)

        verifier = Verifier(KEY, WINDOW, clock)
        yield from pause(loop, 2.0 * WINDOW)  # a new verifier rejects everything at first

        for line in lines(clock):
            replies: list[CommandReply] = []
            verified = attempt(lambda: replies.append(loop.command(verifier.verify(line).text)))  # noqa: B023
            yield replies[0] if replies else verified

    return act


def _replayed(clock: Callable[[], int]) -> tuple[str, ...]:
    line = Signer(KEY, "teleop", clock).sign("walk")
    return line, line


def _commanders(loop: ClosedLoop) -> Steps:
    """Send a text from autonomy while teleop has control."""
    arbiter = Arbiter()
    arbiter.repeat("teleop", (0.1, 0.0, 0.0), loop.t)
    loop.set_velocity(*arbiter.velocity(loop.t))
    yield from pause(loop, 0.1)
    refused = attempt(lambda: arbiter.require("autonomy", loop.t))
    yield loop.command("stop") if refused.accepted else refused


def _locked(loop: ClosedLoop) -> Steps:
    """Send a velocity from teleop while a lock is set."""
    arbiter = Arbiter()
    arbiter.lock("pause", True, loop.t)
    refused = attempt(lambda: arbiter.repeat("teleop", (0.1, 0.0, 0.0), loop.t))
    loop.set_velocity(*arbiter.velocity(loop.t))
    yield refused


#: Time between two kicks, duration of each [s], and the velocity change [m/s]
KICK_PERIOD, KICK_TIME, KICK_SPEED = 4.0, 0.1, 0.2
#: Crane speed and time: upwards, and downwards until the feet bear the weight [m/s, s]
HOIST_SPEED, HOIST_TIME, LOWER_SPEED, LOWER_TIME = 0.3, 0.5, 0.05, 5.0
HANGING_SPEED = 4.0  # maximum joint speed of a hanging robot [rad/s]
BOX = "box"  # terrain with a box that can be placed in the way

#: Velocity of a turn [rad/s] and of a walk [m/s], and free distance to a box at first [m]
TURN, FORWARD, FREE_WAY = 0.3, 0.3, 1.0


def _kick(loop: ClosedLoop) -> Steps:
    force = loop.robot.mass * KICK_SPEED / KICK_TIME
    for number in range(1000):
        angle = 2.4 * number  # [rad] golden angle: directions never repeat
        loop.apply_push((force * np.cos(angle), force * np.sin(angle), 0.0), KICK_TIME)
        yield from pause(loop, KICK_PERIOD)


def _knock_down(loop: ClosedLoop) -> None:
    loop.apply_push((12.0 * loop.robot.mass, 0.0, 0.0), 0.3)


def _crane(loop: ClosedLoop, speed: float, duration: float) -> Steps:
    """Move a held robot up at ``speed`` [m/s] for a time [s]."""
    for _ in pause(loop, duration):
        loop.data.mocap_pos[0, 2] += speed * loop.plant.period
        yield None


def _lift(loop: ClosedLoop) -> Steps:
    """Lift a robot that turns in place, let it hang, lower it, and walk again."""
    loop.set_velocity(0.0, 0.0, TURN)
    yield from pause(loop, 1.5)
    loop.plant.hold()
    yield from _crane(loop, HOIST_SPEED, HOIST_TIME)
    steps, fastest = loop.gait.steps, 0.0
    for _ in pause(loop, 1.5):
        fastest = max(fastest, float(np.abs(loop.truth.v[6:]).max()))
        yield None
    if fastest > HANGING_SPEED:
        yield failure(f"a joint of the hanging robot turns at {fastest:.1f} rad/s")
    for _ in _crane(loop, -LOWER_SPEED, LOWER_TIME):
        yield None
        if loop.plant.load > 0.95 * loop.robot.mass * GRAVITY:
            break
    loop.plant.release()
    yield from pause(loop, 1.0)
    if loop.gait.steps != steps:
        yield failure(f"the gait took {loop.gait.steps - steps} steps in the air")
    loop.set_velocity(0.0, 0.0, 0.0)  # replaces the turn
    loop.set_velocity(FORWARD, 0.0, 0.0)
    yield from pause(loop, 2.5)
    if not loop.gait.steps > steps:
        yield failure("does not continue to walk")


def _stand_in_the_way(loop: ClosedLoop) -> Steps:
    """Place a box in front of a walking robot and remove it later."""
    box = terrain_named(BOX).obstacle
    depth = 0.0 if box is None else box.size[0]
    reach = BodyOutline(loop.robot).reach(np.array([1.0, 0.0]))
    face = float(loop.truth.q[0] + reach) + FREE_WAY
    loop.plant.obstacle.place(face + 0.5 * depth, float(loop.truth.q[1]))
    yield from pause(loop, 6.0)
    left = face - float(loop.truth.q[0] + reach)
    if loop.gait.walking or not 0.1 < left < FREE_WAY:
        yield failure(f"does not stand in front of the box: distance {left:.2f} m")
    loop.plant.obstacle.remove()
    yield from pause(loop, 3.5)
    if not loop.gait.walking:
        yield failure("does not continue to walk after the box was removed")


def _changed(find: Callable[[ClosedLoop], Any], method: str, change: Callable[[Any], Any], ticks: int) -> Act:
    """Change the result of a method of ``find(loop)`` for a number of ticks."""

    def act(loop: ClosedLoop) -> Steps:
        owner = find(loop)
        call = getattr(owner, method)
        with patch.object(owner, method, lambda *arguments: change(call(*arguments))):
            for _ in range(ticks):
                yield None

    return act


def _builder(loop: ClosedLoop) -> QPBuilder:
    if not isinstance(loop.controller, BalanceController):
        raise TypeError("the act needs the packaged controller")
    return loop.controller.whole_body.builder


def _nan_gradient(qp: QP) -> QP:
    qp.gradient[0] = np.nan
    return qp


def _contradiction(qp: QP) -> QP:
    """Make the limits of a joint outside of the legs infeasible: lower limit 1 rad/s^2, upper limit -1."""
    row = np.flatnonzero(qp.soft & (np.abs(qp.matrix).sum(axis=1) == 1.0))[0]
    qp.lower[row], qp.upper[row] = 1.0, -1.0
    return qp


def _nan_torques(result: ControlResult) -> ControlResult:
    tau = np.full_like(result.command.tau, np.nan)
    return structs.replace(result, command=structs.replace(result.command, tau=tau))


ACTS: Mapping[str, Act] = {
    "contradict": _changed(_builder, "build", _contradiction, 500),
    "corrupt_once": _changed(_builder, "build", _nan_gradient, 1),
    "corrupt": _changed(_builder, "build", _nan_gradient, 100),
    "nan_once": _changed(lambda loop: loop.controller, "step", _nan_torques, 1),
    "nan_torque": _changed(lambda loop: loop.controller, "step", _nan_torques, 200),
    "trajectory_unknown_joint": _wrong(lambda held, robot: {"joint_names": ("tail_joint", *held.joint_names[1:])}),
    "trajectory_joint_twice": _wrong(lambda held, robot: {"joint_names": (held.joint_names[1], *held.joint_names[1:])}),
    "trajectory_nan": _wrong(lambda held, robot: {"positions": _with(held.positions, 1, np.nan)}),
    "trajectory_equal_times": _wrong(_times(0.5, 0.5)),
    "trajectory_times_back": _wrong(_times(1.0, 0.5)),
    "trajectory_past": _wrong(_times(-2.0, -1.0)),
    "trajectory_begun": _wrong(_times(-0.5, 0.5)),
    "trajectory_outside": _wrong(
        lambda held, robot: {"positions": _with(held.positions, slice(None), robot.q_upper[0] + 0.1)}
    ),
    "trajectory_too_fast": _wrong(
        lambda held, robot: {"velocities": _with(np.zeros_like(held.positions), 0, 2.0 * robot.v_max[0])}
    ),
    "trajectory_jump": _wrong(
        lambda held, robot: {"times": np.array([0.0, 1.0]), "positions": 0.5 * (held.positions + robot.q_upper)}
    ),
    "trajectory_empty": _wrong(_points(0)),
    "trajectory_of_100000": _wrong(_points(100_000)),
    "long_text": commands("x" * 1_000_000),
    "unknown_text": commands("fly"),
    "squat": commands("squat"),
    "stand": _stand_in_walk,
    "busy": commands("squat", "wave"),
    "walk_from_squat": commands("squat", "walk"),
    "flood": _flood,
    "calibrate": once(lambda loop: loop.calibrate("imu")),
    "forward": _velocity(0.3),
    "nan_velocity": _velocity(math.nan),
    "walk_damped": _walk_damped,
    "stand_fallen": _stand_fallen,
    "unsigned": _signed(lambda clock: ("walk",)),
    "forged": _signed(lambda clock: (Signer(OTHER_KEY, "teleop", clock).sign("walk"),)),
    "replayed": _signed(_replayed),
    "commanders": _commanders,
    "locked": _locked,
    "kick": _kick,
    "knock_down": once(_knock_down),
    "lift": _lift,
    "stand_in_the_way": _stand_in_the_way,
}
