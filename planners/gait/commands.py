"""Commands of a walk: a velocity or a route, within limits, and the number of steps until the walk ends."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from msgspec import Struct, structs

from models.errors import CommandError
from models.types import STILL, Velocity
from planners.gait.config import GaitConfig, VelocityConfig
from planners.gait.footsteps import LEFT, RIGHT, Foothold
from planners.gait.pace import velocity_within
from planners.gait.route import Footstep, Route, check_footsteps, plan_to_pose, route_of, route_over, soles_after
from planners.gait.speed import SpeedTrim


class VelocityCommand:
    """Newest velocity (forward, left [m/s], turn [rad/s]) of a source; zero ``timeout`` [s] after the last message."""

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self.forget()

    def forget(self) -> None:
        """Set the velocity to zero; no repetition is expected."""
        self.velocity, self._until = STILL, float("inf")
        self._superseded: Velocity | None = None

    def supersede(self) -> None:
        """Another command moves the robot; ignore this velocity until its value changes."""
        self._superseded, self.velocity = self.velocity, STILL

    def repeat(self, velocity: Velocity, t: float) -> None:
        """Accept a velocity at the present stamp [s]; the source must repeat it within ``timeout``."""
        if velocity != self._superseded:
            self._superseded, self.velocity = None, velocity
        self._until = t + self._timeout

    def lapsed(self, t: float) -> bool:
        """Whether the timeout has passed at a stamp [s]; true once, and sets the velocity to zero."""
        if t <= self._until:
            return False
        self.forget()
        return True


class CommandState(Struct, frozen=True):
    """Command of a walk."""

    target: Velocity = STILL  # commanded velocity, within the velocity limits
    velocity: Velocity = STILL  # velocity of the present step, within the acceleration limits
    muted: bool = False  # velocities are ignored until zero is commanded once
    route: Route = Route()  # footsteps that replace the footsteps of the velocity
    steps_left: int | None = None  # touchdowns until the walk ends; None if it continues
    trim: SpeedTrim = SpeedTrim()

    @property
    def asked(self) -> Velocity:
        """Velocity of the nominal steps that result in the present velocity."""
        return self.trim.of(self.velocity)

    @property
    def moving(self) -> bool:
        """Whether a velocity or a route requires steps."""
        return self.moves or bool(self.route.steps)

    @property
    def moves(self) -> bool:
        """Whether the commanded velocity is not zero."""
        forward, left, turn = self.target
        return abs(forward) > 1e-3 or abs(left) > 1e-3 or abs(turn) > 1e-3

    @property
    def over(self) -> bool:
        """Whether the last step has touched down."""
        return self.steps_left is not None and self.steps_left <= 0

    @property
    def first_foot(self) -> int:
        """Foot of the first step: the first foot of the route, or the foot on the side of the velocity."""
        if self.route.steps:
            return self.route.foot
        _, left, turn = self.target
        lean = left if abs(left) > 1e-6 else turn
        return LEFT if lean >= 0.0 else RIGHT

    def stopped(self, reason: str, *, muted: bool = False) -> CommandState:
        """State without target and route; the velocity of the present step decreases gradually unless muted."""
        steps_left = None if self.route.steps else self.steps_left
        velocity = STILL if muted else self.velocity
        return CommandState(STILL, velocity, muted or self.muted, self.route.ended(reason), steps_left)

    def counted(self, steps_left: int | None) -> CommandState:
        """State with a new number of touchdowns until the walk ends."""
        return structs.replace(self, steps_left=steps_left)


NO_COMMAND = CommandState()


class Commands:
    """Accepts commands and counts down the last steps."""

    def __init__(self, config: GaitConfig) -> None:
        self._config = config

    def set_velocity(self, state: CommandState, velocity: Velocity) -> CommandState:
        """Accept a velocity; see ``GaitPlanner.set_velocity``."""
        if not all(math.isfinite(value) for value in velocity):
            raise CommandError(f"velocity ({', '.join(map(str, velocity))}) refused: not finite")
        muted = state.muted and any(velocity)
        state = structs.replace(state, muted=muted)
        if muted:
            return state
        state = structs.replace(state, target=limited(velocity, self._config.velocity))
        if state.moves and state.route.steps:
            state = structs.replace(state, route=state.route.ended("a velocity was commanded"), steps_left=None)
        return state

    def walk_to(
        self,
        state: CommandState,
        goal: Foothold,
        soles: Sequence[Foothold],
        foot: int | None,
        current: Footstep | None = None,
    ) -> CommandState:
        """Start a route from ``soles`` after ``current`` to a pose of their middle; ``foot`` is next (None: either)."""
        steps = plan_to_pose(goal, soles, self._config, foot)
        if current is not None:
            steps.insert(0, current)
        route = route_of(steps, goal, self._config.route.steps_more)
        return structs.replace(state, route=route, target=STILL, velocity=STILL)

    def take_steps(
        self,
        state: CommandState,
        steps: Sequence[Footstep],
        soles: Sequence[Foothold],
        levels: Sequence[float],
        stance: int,
        kept: int = 0,
    ) -> CommandState:
        """Start listed footsteps from soles at known ``levels`` [m], after the next ``kept`` footsteps of the route.

        Heights are relative to the ``stance`` sole. See ``check_footsteps`` for errors.
        """
        datum = soles[stance].z - levels[stance]
        before = state.route.steps[:kept]
        if before and steps and steps[0].foot == before[-1].foot:
            raise CommandError("footsteps refused: they begin with the foot that steps just before")
        check_footsteps(steps, soles_after(before, soles, datum), self._config)
        raised = [step.raised(datum) for step in before]
        route = route_over([*raised, *steps], soles, datum, self._config, kept)
        return structs.replace(state, route=route, target=STILL, velocity=STILL)

    def advance(self, state: CommandState, stepping: bool, dt: float, longest: float = math.inf) -> CommandState:
        """Advance the velocity by ``dt`` [s]; after a zero command while ``stepping``, two more steps are taken.

        The steps of the velocity are at most ``longest`` [m] long.
        """
        if state.route.steps:
            return state.counted(state.route.left if state.route.left <= self._config.preview else None)
        if state.moves:
            target = velocity_within(state.target, longest, self._config.pace)
            if state.velocity == target and state.steps_left is None:
                return state
            velocity = approached(state.velocity, target, self._config.velocity, dt)
            return structs.replace(state, velocity=velocity, steps_left=None)
        if stepping:
            return state.counted(2) if state.steps_left is None else state
        return (
            state if state.target == state.velocity == STILL else structs.replace(state, target=STILL, velocity=STILL)
        )

    def landed(self, state: CommandState, soles: Sequence[Foothold]) -> CommandState:
        """State after a touchdown, with the present soles."""
        if state.route.steps:
            route = state.route.landed(soles, self._config)
            return structs.replace(state, route=route, steps_left=route.left)
        return state if state.steps_left is None else state.counted(state.steps_left - 1)


def limited(velocity: Velocity, limits: VelocityConfig) -> Velocity:
    """Velocity clipped to the velocity limits."""
    forward, left, turn = velocity
    return (
        min(max(forward, -limits.backward), limits.forward),
        min(max(left, -limits.lateral), limits.lateral),
        min(max(turn, -limits.turn), limits.turn),
    )


def exceeded(velocity: Velocity, limits: VelocityConfig, causes: Mapping[str, str]) -> dict[str, str]:
    """Texts about components of a velocity that exceed the limits, by component; ``causes`` are by limit name."""
    kept, found = limited(velocity, limits), {}
    names = "forward" if velocity[0] >= 0.0 else "backward", "lateral", "turn"
    parts = zip(("forward", "left", "turn"), ("m/s", "m/s", "rad/s"), names, velocity, kept, strict=True)
    for name, unit, limit, given, most in parts:
        if given != most:
            cause = f" by {causes[limit]}" if limit in causes else ""
            found[name] = f"{name} {given:.3g} limited to {round(most, 3):.3g} {unit}{cause}"
    return found


def approached(velocity: Velocity, target: Velocity, limits: VelocityConfig, dt: float) -> Velocity:
    """Velocity after a time [s] of change toward a target, within the acceleration limits."""
    linear, turning = limits.acceleration * dt, limits.turn_acceleration * dt
    (vx, vy, turn), (target_x, target_y, target_turn) = velocity, target
    return (
        vx + min(max(target_x - vx, -linear), linear),
        vy + min(max(target_y - vy, -linear), linear),
        turn + min(max(target_turn - turn, -turning), turning),
    )
