"""Schema of ``planners/config/ground.yaml``."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Count, NonNegative, Positive, Share

Room = Annotated[float, Field(ge=0.02, le=1.0)]  #: At least a place of the lattice


@dataclass(frozen=True, slots=True, config=STRICT)
class WatchConfig:
    """What a walking robot watches of the ground, and when it walks on plans."""

    ahead: Positive  #: How far ahead of the feet the ground is watched at least [m]
    beside: Positive  #: The same to the sides and behind [m]
    preview_time: NonNegative  #: And how far in time, at the commanded velocity [s]
    answer_timeout: Positive  #: Longest wait for the answer whether the ground is level [s]
    retry_period: Positive  #: After which a robot that was stopped asks again [s]
    speed_min: NonNegative  #: Speed up to which nothing is watched [m/s]
    turn_min: Positive  #: Heading from the line of a plan that the robot turns by first [rad]
    heading_error: Positive  #: Heading from that of the goal that it turns by at the end [rad]
    cone: Annotated[float, Field(gt=0.0, lt=1.57)]  #: Between two directions up to which they count as one [rad]
    near_goal: Positive  #: Distance from a goal up to which the ground is watched ahead, not towards it [m]
    line_length: Positive  #: Length of the line of a velocity [m]
    look_time: NonNegative  #: How long it looks before it asks for a way around [s]
    detours_max: Count  #: Ways around that are tried for a goal


@dataclass(frozen=True, slots=True, config=STRICT)
class RouteConfig:
    """Plans on the way along a line."""

    look_time: NonNegative  #: How long a standing robot looks before it plans [s]
    kept: Count  #: Footsteps that a plan on the way does not change
    change_max: Positive  #: Change of a foothold with which a plan may come a touchdown late [m]
    arrived: Positive  #: From the end of the way, where the walk is over [m]
    shortfall_max: Positive  #: By which a plan may end before the one that it replaces [m]
    horizon: Positive  #: How far ahead of the feet is planned at most [m]
    plan_timeout: Positive  #: Longest wait for a plan [s]
    stops_max: Count  #: After so many stops for a plan that became void, the next one ends the walk


@dataclass(frozen=True, slots=True, config=STRICT)
class SoleConfig:
    """Ground that a sole lies on."""

    beside: NonNegative  #: To either side of it, the ground that its plane is fitted to as well [m]
    flat: Positive  #: Largest deviation of that ground from its plane [m]
    rough: Positive  #: The same where a sole may be moved to sideways [m]
    same: Positive  #: Difference of height between neighbours of the lattice on the same ground [m]
    along: Room  #: Way ahead and back by which a sole may move on its ground that is looked for [m]
    across: Room  #: The same to the sides [m]
    higher: Positive  #: Above the plane of a sole from which on ground is higher [m]
    wall: Positive  #: Distance ahead or behind of a leg from which on higher ground does not matter [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class CostsConfig:
    """Costs of a plan; each step costs 1."""

    left: NonNegative  #: Of every stride of the distance that is left while it is searched [-]
    short: NonNegative  #: And at the end of a plan: more than a step in reach costs, so that it goes on [-]
    long: NonNegative  #: Of the square of what a step is longer than the stride, or its swing than two [1/m^2]
    crouch: NonNegative  #: Of the square of how much lower the body is between both soles [1/m^2]
    edge: NonNegative  #: Of a sole beside an edge [-]
    wall: NonNegative  #: Of the squared share by which higher ground ahead or behind is too near to the leg [-]
    line: NonNegative  #: Of the square of a sole's distance from its nominal place beside the line [1/m^2]
    width: NonNegative  #: Of the square of the difference from the nominal width between the feet [1/m^2]


@dataclass(frozen=True, slots=True, config=STRICT)
class PlanConfig:
    """Footsteps on known ground."""

    stride: Positive  #: Usual length of a step [m]
    aside: Positive  #: To either side of the line footholds reach [m]
    shift: Positive  #: From the line to those beside it [m]
    short_way: Positive  #: A plan that ends before this way is compared with those beside it [m]
    arrived: Positive  #: From the end of the way, where a plan is complete [m]
    level: Positive  #: Difference of height from which ground is another [m]
    stray: Positive  #: Cells off a level from which on it is none, higher ones counted by their height
    lowest: Annotated[float, Field(ge=0.0, le=50.0)]  #: Of the known ground that counts as its lowest [%]
    changed: Share  #: Share of the ground of a step that is off its plan from which on the plan is void [-]
    passed: Share  #: Share of `reach.rise` for what a foot passes on its way [-]
    beside: Positive  #: Way up to which feet are beside each other before and after a step to another level [m]
    together: Positive  #: The same at the end of a plan [m]
    comfort: Positive  #: Room ahead and back from which on an edge does not matter [m]
    inside: NonNegative  #: A step is planned so far inside the reach [m]
    stance: Positive  #: Difference from the nominal stance in which a plan may end, beyond the width of a sole [m]
    sole: SoleConfig
    costs: CostsConfig


@dataclass(frozen=True, slots=True, config=STRICT)
class GroundConfig:
    """Walking on known ground."""

    watch: WatchConfig
    route: RouteConfig
    plan: PlanConfig
