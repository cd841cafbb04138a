"""Routes: footsteps to a pose or from a list, their validation, and the remaining steps of a route."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

from msgspec import Struct, structs

from models.constants import FOOT_NAMES
from models.errors import CommandError, PoiseError, UnreachableError
from models.types import Velocity
from planners.gait.config import GaitConfig
from planners.gait.footsteps import (
    LEFT,
    RIGHT,
    Feet,
    Foothold,
    StepLimits,
    clamped,
    middle,
    next_foothold,
    side_of,
    wrap,
)
from planners.gait.tread import Tread, clearance_over, crouch_between, swing_time

SLACK = 1e-6  #: Tolerance of the limits for rounding [m, rad]
_ANY_ROOM = (math.inf,) * 4  #: Room of a tread without bounds in ``Footstep.values`` [m]


@dataclass(frozen=True, slots=True)
class Footstep:
    """One step of a plan: ``foot`` (0 left, 1 right) is placed at ``hold``, whose height is used only with a ``tread``.

    ``route_over`` sets ``time``, the least nominal single support [s].
    """

    foot: int
    hold: Foothold
    tread: Tread | None = None
    time: float = field(default=0.0, compare=False)

    def __post_init__(self) -> None:
        if self.foot not in (LEFT, RIGHT):
            raise ValueError(f"foot {self.foot} of a footstep is neither {LEFT} (left) nor {RIGHT} (right)")

    def raised(self, height: float) -> Footstep:
        """The step with its foothold raised by ``height`` [m]."""
        return replace(self, hold=structs.replace(self.hold, z=self.hold.z + height))

    @property
    def values(self) -> list[float]:
        """Foot and foothold as numbers, with slope, room and ``over`` of a tread; inverse of ``footstep_of``."""
        known = self.tread
        tread = () if known is None else (*known.slope, *(known.room or _ANY_ROOM), known.over)
        return [self.foot, *structs.astuple(self.hold), *tread]

    @property
    def over(self) -> float:
        """``Tread.over``; 0 where the ground is felt [m]."""
        return 0.0 if self.tread is None else self.tread.over

    def kept(self, hold: Foothold) -> Foothold:
        """The foothold nearest to ``hold`` within the room of the tread."""
        if self.tread is None or self.tread.room is None:
            return hold
        (x, y), (back, forward, right, left) = self.hold.relative(hold.x, hold.y), self.tread.room
        x, y = self.hold.moved(min(max(x, -back), forward), min(max(y, -right), left))
        return structs.replace(hold, x=x, y=y)


def footstep_of(foot: float, x: float, y: float, yaw: float, z: float, *tread: float) -> Footstep:
    """Footstep from its ``values``."""
    known = None
    if tread:
        rise_x, rise_y, back, forward, right, left, over = tread
        known = Tread((rise_x, rise_y), None if math.isinf(back) else (back, forward, right, left), over)
    return Footstep(int(foot), Foothold(x, y, yaw, z), known)


def soles_at(pose: Foothold, width: float) -> tuple[Foothold, Foothold]:
    """Both soles of a robot that stands at a pose, ``width`` apart [m]."""
    left, right = (Foothold(*pose.moved(0.0, side * 0.5 * width), pose.yaw, pose.z) for side in (1.0, -1.0))
    return left, right


def plan_to_pose(
    goal: Foothold, soles: Sequence[Foothold], config: GaitConfig, foot: int | None = None
) -> list[Footstep]:
    """Footsteps from the present soles to soles side by side at a pose; empty if already there.

    Each step follows the quickest of three ways: translate and then turn, turn and then translate, or face the goal,
    walk there and turn. ``foot`` steps first; None: the foot on the side of the motion. Raises ``CommandError`` if the
    goal is not finite, ``UnreachableError`` if it is too far away or takes too many steps.
    """
    if not all(math.isfinite(value) for value in (goal.x, goal.y, goal.yaw)):
        raise CommandError(f"goal ({goal.x}, {goal.y}, {goal.yaw}) refused: not finite")
    here = middle(soles)
    far = math.hypot(goal.x - here.x, goal.y - here.y)
    if far > config.route.range:
        raise UnreachableError(f"the goal is {far:.1f} m away, at most {config.route.range:g} m")
    if foot is None:
        _, left, turn = velocity_towards(goal, here, 1.0, config)
        lean = left if abs(left) > SLACK else turn
        foot = LEFT if lean >= 0.0 else RIGHT
    return list(_steps(goal, soles, config, foot))


def touchdown_times(count: int, config: GaitConfig) -> list[float]:
    """Touchdown times of an undisturbed walk from its start, t_k = t_start + k t_single + (k - 1) t_double [s]."""
    first = config.timing.start + config.pace.between(config.route.pace, "single")
    return [first + k * config.period for k in range(count)]


def _steps(goal: Foothold, soles: Sequence[Foothold], config: GaitConfig, foot: int) -> Iterator[Footstep]:
    ends = soles_at(goal, config.reach.width)
    feet = list(soles)
    for _ in range(config.route.steps_max):
        if _arrived(feet, goal, config):
            return
        feet[foot] = _step_towards(goal, ends[foot], feet[1 - foot], foot, config)
        yield Footstep(foot, feet[foot])
        foot = 1 - foot
    raise UnreachableError(f"the goal is more than {config.route.steps_max} steps away")


def _arrived(soles: Sequence[Foothold], goal: Foothold, config: GaitConfig) -> bool:
    route, here = config.route, middle(soles)
    (x, left), (other_x, right) = (here.relative(sole.x, sole.y) for sole in soles)  # mirrored like the soles
    ahead, out = x - other_x, left - right
    return (
        math.hypot(here.x - goal.x, here.y - goal.y) <= route.position_tolerance
        and abs(wrap(here.yaw - goal.yaw)) <= route.turn_tolerance
        and abs(ahead) <= route.position_tolerance
        and abs(wrap(soles[LEFT].yaw - soles[RIGHT].yaw)) <= route.turn_tolerance
        and config.reach.width_min <= out <= config.reach.width_max
    )


def _step_towards(goal: Foothold, end: Foothold, stance: Foothold, foot: int, config: GaitConfig) -> Foothold:
    """The next foothold of a foot: ``end`` if it is within one step, otherwise a foothold towards it."""
    side, period, route = side_of(foot), config.period, config.route
    centre = Foothold(*stance.moved(0.0, side * 0.5 * config.reach.width), stance.yaw, stance.z)
    x, y = centre.relative(goal.x, goal.y)
    turn = wrap(goal.yaw - centre.yaw)
    fits = abs(x) <= route.forward * period + SLACK and abs(y) <= route.lateral * period + SLACK
    if fits and abs(turn) <= route.turn * period + SLACK and _out_of_reach(stance, foot, end, config) is None:
        return Foothold(end.x, end.y, end.yaw, stance.z)
    return next_foothold(stance, foot, velocity_towards(goal, centre, side, config), period, config.reach)


def velocity_towards(goal: Foothold, centre: Foothold, side: float, config: GaitConfig) -> Velocity:
    """Velocity of the next step of the quickest way, reduced so that equal steps end where the way ends.

    ``centre`` is the pose of the body. ``side`` (+1 or -1) is the direction of a turn by exactly half a turn, so that
    mirrored goals give mirrored steps.
    """
    route = config.route
    x, y = centre.relative(goal.x, goal.y)
    turn = _signed(goal.yaw - centre.yaw, side)
    bearing, far = _signed(math.atan2(y, x), side) if math.hypot(x, y) > SLACK else 0.0, math.hypot(x, y)
    if far < route.position_tolerance and abs(turn) > SLACK:
        return 0.0, 0.0, _equal(turn, route.turn, config.period)
    turned = goal.relative(centre.x, centre.y)
    translate = max(abs(x) / route.forward, abs(y) / route.lateral)
    times = (
        translate + abs(turn) / route.turn,
        abs(turn) / route.turn + max(abs(turned[0]) / route.forward, abs(turned[1]) / route.lateral),
        abs(bearing) / route.turn + far / route.forward + abs(_signed(turn - bearing, side)) / route.turn,
    )
    quickest = times.index(min(times))
    if quickest == 2:
        if abs(bearing) > route.turn * config.period:
            return 0.0, 0.0, _equal(bearing, route.turn, config.period)
        return _equal(far, route.forward, config.period), 0.0, bearing / config.period
    if quickest == 1 and abs(turn) > SLACK:
        return 0.0, 0.0, _equal(turn, route.turn, config.period)
    steps = max(math.ceil(translate / config.period - SLACK), 1)
    return x / (steps * config.period), y / (steps * config.period), 0.0


def _equal(way: float, speed: float, period: float) -> float:
    """Largest speed up to ``speed`` at which a whole number of steps covers the way."""
    return way / (max(math.ceil(abs(way) / (speed * period) - SLACK), 1) * period)


def _signed(angle: float, side: float) -> float:
    """The angle in [-pi, pi]; half a turn has the sign of ``side``."""
    wrapped = wrap(angle)
    return side * math.pi if abs(wrapped) > math.pi - SLACK else wrapped


def check_footsteps(steps: Sequence[Footstep], soles: Sequence[Foothold], config: GaitConfig) -> None:
    """Raise ``CommandError`` or ``UnreachableError`` for footsteps that are impossible from the left and right sole."""
    if not 0 < len(steps) <= config.route.steps_max:
        raise CommandError(f"{len(steps)} footsteps refused: 1 to {config.route.steps_max} can be taken")
    feet = list(soles)
    for i, step in enumerate(steps):
        name, hold = f"footstep {i + 1} ({FOOT_NAMES[step.foot]}) refused", step.hold
        if not all(math.isfinite(value) for value in (hold.x, hold.y, hold.yaw)):
            raise CommandError(f"{name}: ({hold.x}, {hold.y}, {hold.yaw}) is not finite")
        if i and step.foot == steps[i - 1].foot:
            raise CommandError(f"{name}: the same foot as before")
        before, stance = middle(feet), feet[1 - step.foot]
        reason = _out_of_reach(stance, step.foot, hold, config)
        if step.tread is None:
            hold = structs.replace(hold, z=stance.z)
        reason = reason or _too_steep(stance, step.foot, hold, step.tread, config)
        feet[step.foot] = hold
        reason = reason or _too_fast(before, middle(feet), config)
        if reason is not None:
            raise UnreachableError(f"{name}: {reason}")


def _out_of_reach(stance: Foothold, foot: int, hold: Foothold, config: GaitConfig) -> str | None:
    """Reason why a foot cannot be placed there; None if it can."""
    reach, other = config.reach, f"the {FOOT_NAMES[1 - foot]} sole"
    side = side_of(foot)
    forward, left = stance.relative(hold.x, hold.y)
    out, opening = side * left, side * wrap(hold.yaw - stance.yaw)
    if forward > reach.forward + SLACK:
        return f"{forward:.3f} m ahead of {other}, at most {reach.forward:.3f} m"
    if -forward > reach.backward + SLACK:
        return f"{-forward:.3f} m behind {other}, at most {reach.backward:.3f} m"
    if out < reach.width_min - SLACK:
        return f"legs would cross or touch: {out:.3f} m outwards of {other}, at least {reach.width_min:.3f} m"
    if out > reach.width_max + SLACK:
        return f"{out:.3f} m outwards of {other}, at most {reach.width_max:.3f} m"
    if opening > reach.turn_out + SLACK:
        return f"turned out by {opening:.3f} rad from {other}, at most {reach.turn_out:.3f} rad"
    if -opening > reach.turn_in + SLACK:
        return f"turned in by {-opening:.3f} rad from {other}, at most {reach.turn_in:.3f} rad"
    return None


def _too_steep(stance: Foothold, foot: int, hold: Foothold, tread: Tread | None, config: GaitConfig) -> str | None:
    """Reason why a foot cannot be placed at this height and tilt; None if it can."""
    rise, most = hold.z - stance.z, config.reach.rise
    if not abs(rise) <= most + SLACK:  # also refuses a NaN
        way = "above" if rise > 0.0 else "below"
        return f"{abs(rise):.3f} m {way} the {FOOT_NAMES[1 - foot]} sole, at most {most:.3f} m"
    if tread is not None and not 0.0 <= tread.over <= most:
        return f"over ground {tread.over:.3f} m higher than its ends, from 0 to {most:.3f} m"
    slope = 0.0 if tread is None else math.hypot(*tread.slope)
    if not slope <= config.ground.slope_max + SLACK:
        return f"tilted by {math.atan(slope):.3f} rad, at most {math.atan(config.ground.slope_max):.3f} rad"
    return None


def _too_fast(before: Foothold, after: Foothold, config: GaitConfig) -> str | None:
    """Reason why the body cannot move that far in one step; None if it can."""
    limits, period = config.velocity, config.period
    forward, left = before.relative(after.x, after.y)
    ahead = limits.forward if forward >= 0.0 else limits.backward
    for what, way, most, unit in (
        ("along", abs(forward), ahead * period, "m"),
        ("sideways", abs(left), limits.lateral * period, "m"),
        ("round", abs(wrap(after.yaw - before.yaw)), limits.turn * period, "rad"),
    ):
        if way > most + SLACK:
            return f"moves the body {what} by {way:.3f} {unit} in one step, at most {most:.3f} {unit}"
    return None


class Route(Struct, frozen=True):
    """Remaining footsteps of a walk to a goal, or of listed footsteps.

    They are fixed in W: after a push or a slip, the next steps correct the landing error of a step as far as the reach
    allows. A route to a goal is planned again if a foot lands farther than ``offset_max`` from its foothold, or if the
    other foot must step to keep the balance, which ends listed footsteps. If feet still miss their footholds after
    ``steps_more`` footsteps more than twice those of the first plan, the route is aborted.
    """

    steps: tuple[Footstep, ...] = ()  # empty without a route
    goal: Foothold | None = None  # pose of the middle between the soles at the end; None for listed footsteps
    outcome: str = ""  # why the last route ended, ``done`` after all its steps; empty until then
    crouch: float = 0.0  # descent of the body for known heights and long steps, see ``crouch_between`` [m]
    patience: int = 0  # touchdowns after which a miss ends the route

    @property
    def left(self) -> int:
        """Number of remaining touchdowns; 0 without a route."""
        return len(self.steps)

    @property
    def swing(self) -> float:
        """Least nominal single support of the next step, for the known height of its swing [s]."""
        return self.steps[0].time if self.steps else 0.0

    @property
    def known(self) -> bool:
        """Whether the height of the next foothold is known."""
        return bool(self.steps) and self.steps[0].tread is not None

    @property
    def foot(self) -> int:
        """Foot that steps next; there must be a route."""
        return self.steps[0].foot

    def ended(self, reason: str) -> Route:
        """The route without its remaining steps."""
        return structs.replace(self, steps=(), outcome=reason) if self.steps else self

    def ahead(self, stance: Foothold, count: int, limits: StepLimits, level: float = 0.0) -> list[Foothold]:
        """At most ``count`` next footholds of alternating feet, each clamped to the reach from the one before.

        ``level`` is the known height of the ``stance``, with the same zero as the heights of the steps [m].
        """
        holds: list[Foothold] = []
        base = stance.z - level
        for step in self.steps[:count]:
            stance = clamped(stance, step.foot, *step.hold.pose, limits)
            if step.tread is not None:
                stance = structs.replace(stance, z=base + step.hold.z)
            holds.append(stance)
        return holds

    def landed(self, soles: Sequence[Foothold], config: GaitConfig) -> Route:
        """The route after its next step, with the present soles."""
        step, steps = self.steps[0], self.steps[1:]
        outcome = self.outcome if steps or self.outcome else "done"
        after = structs.replace(self, steps=steps, outcome=outcome, patience=self.patience - 1)
        hold = soles[step.foot]
        missed = math.hypot(hold.x - step.hold.x, hold.y - step.hold.y)
        if missed <= config.route.offset_max or self.goal is None:
            return after
        if after.patience > 0:
            return after.planned_anew(1 - step.foot, soles, config)
        reason = f"the feet miss their footholds: error of the last one {missed:.3f} m"
        return structs.replace(after, steps=(), outcome=reason)

    def planned_anew(self, foot: int, soles: Sequence[Foothold], config: GaitConfig) -> Route:
        """The route planned again from these soles to its goal, ``foot`` first; ended if there is no way or no goal."""
        steps: tuple[Footstep, ...] = ()
        outcome = f"the {FOOT_NAMES[foot]} foot had to step first to keep the balance"
        if self.goal is not None:
            try:
                steps = tuple(plan_to_pose(self.goal, soles, config, foot))
                outcome = "" if steps else "done"
            except PoiseError as error:
                outcome = str(error)
        return structs.replace(self, steps=steps, outcome=outcome)


def route_of(steps: Sequence[Footstep], goal: Foothold | None = None, steps_more: int = 0) -> Route:
    """A new route; ``steps_more`` applies to a route to a goal."""
    return Route(tuple(steps), goal, "" if steps else "done", patience=2 * len(steps) + steps_more)


def soles_after(steps: Sequence[Footstep], soles: Sequence[Foothold], datum: float) -> Feet:
    """Left and right sole after steps of a route, whose known heights are relative to ``datum`` [m]."""
    feet = list(soles)
    for step in steps:
        height = feet[1 - step.foot].z if step.tread is None else step.hold.z + datum
        feet[step.foot] = structs.replace(step.hold, z=height)
    left, right = feet
    return left, right


def route_over(
    steps: Sequence[Footstep], soles: Sequence[Foothold], datum: float, config: GaitConfig, kept: int = 0
) -> Route:
    """A new route of listed footsteps from the left and right sole; its known heights are relative to ``datum`` [m].

    All steps take as long as the slowest one, at most ``single_max``. The first ``kept`` steps are those of the last
    route and keep their time.
    """
    feet, crouch, least, swing = list(soles), 0.0, 0.0, config.swing
    level = config.pace.between(config.route.pace, "clearance")
    for step in steps:
        stance, before, side = feet[1 - step.foot], feet[step.foot], side_of(step.foot)
        hold = feet[step.foot] = step.hold if step.tread is not None else structs.replace(step.hold, z=stance.z)
        rise = 0.0
        if step.tread is not None:
            crouch = max(crouch, crouch_between(stance, hold, side, config.reach.width, config.leg))
            rise = hold.z - before.z
        clearance = clearance_over(rise, level, swing.edge_clearance, step.over)
        least = max(least, swing_time(rise, clearance, swing.apex, swing.lift_acceleration))
        if step.over:  # the foot moves ahead only while it is above the obstacle
            least = config.timing.single_max
    timed = [
        step if i < kept else replace(step, time=min(least, config.timing.single_max)) for i, step in enumerate(steps)
    ]
    return structs.replace(route_of([step.raised(-datum) for step in timed]), crouch=crouch)
