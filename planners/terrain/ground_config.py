"""Schema of ``planners/config/ground.yaml``."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Count, NonNegative, Positive, Share

Room = Annotated[float, Field(ge=0.02, le=1.0)]  #: At least one place of the lattice


@dataclass(frozen=True, slots=True, config=STRICT)
class WatchConfig:
    """Monitoring of the ground during a walk, and the switch to planned footsteps."""

    ahead: Positive  #: Least distance ahead of the feet up to which the ground is checked [m]
    beside: Positive  #: The same to the sides and behind [m]
    preview_time: NonNegative  #: Time at the commanded velocity by which the checked distance is extended [s]
    answer_timeout: Positive  #: Longest wait for the answer whether the ground is level [s]
    retry_period: Positive  #: Period of the requests of a robot that was stopped [s]
    speed_min: NonNegative  #: Speed up to which the ground is not checked [m/s]
    turn_min: Positive  #: Heading error to the line of a plan above which the robot turns first [rad]
    heading_error: Positive  #: Heading error at the goal above which the robot turns at the end [rad]
    cone: Annotated[float, Field(gt=0.0, lt=1.57)]  #: Angle up to which two directions count as one [rad]
    near_goal: Positive  #: Distance to a goal up to which the ground ahead is checked, not the ground towards it [m]
    line_length: Positive  #: Length of the line of plans at a velocity [m]
    look_time: NonNegative  #: Time for observation before a detour is requested [s]
    detours_max: Count  #: Largest number of detours for one goal


@dataclass(frozen=True, slots=True, config=STRICT)
class RouteConfig:
    """Plans during a walk along a line."""

    look_time: NonNegative  #: Time for observation of a standing robot before a plan is requested [s]
    kept: Count  #: Number of next footsteps that a plan during the walk does not change
    change_max: Positive  #: Largest change of the first foothold of a plan that comes a touchdown late [m]
    arrived: Positive  #: Distance to the end of the line at which the walk is complete [m]
    shortfall_max: Positive  #: Largest distance by which a plan may end before the plan that it replaces [m]
    horizon: Positive  #: Largest distance of a plan ahead of the feet [m]
    plan_timeout: Positive  #: Longest wait for a plan [s]
    stops_max: Count  #: Number of stops for an invalid plan after which the next one ends the walk


@dataclass(frozen=True, slots=True, config=STRICT)
class SoleConfig:
    """Ground under a sole."""

    beside: NonNegative  #: Width of the ground on either side of the sole that its plane is also fitted to [m]
    flat: Positive  #: Largest deviation of that ground from its plane [m]
    rough: Positive  #: The same for ground onto which a sole may only be moved sideways [m]
    same: Positive  #: Largest height difference between neighbours of the lattice on the same ground [m]
    along: Room  #: Largest distance ahead and back by which a sole may move on its ground [m]
    across: Room  #: The same to the sides [m]
    higher: Positive  #: Height above the plane of a sole from which ground counts as higher [m]
    wall: Positive  #: Distance ahead of or behind a leg from which higher ground has no effect [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class CostsConfig:
    """Costs of a plan; each step costs 1."""

    left: NonNegative  #: Cost of each stride of remaining distance during the search [-]
    short: NonNegative  #: The same at the end of a plan; more than a step in reach costs, so that the plan goes on [-]
    long: NonNegative  #: Cost of the squared excess of a step over the stride, and of its swing over two [1/m^2]
    crouch: NonNegative  #: Cost of the squared crouch of the body between both soles [1/m^2]
    edge: NonNegative  #: Cost of a sole beside an edge [-]
    wall: NonNegative  #: Cost of the squared proximity of higher ground to the leg, as a share of `sole.wall` [-]
    line: NonNegative  #: Cost of the squared distance of a sole from its nominal place beside the line [1/m^2]
    width: NonNegative  #: Cost of the squared deviation from the nominal width between the feet [1/m^2]


@dataclass(frozen=True, slots=True, config=STRICT)
class PlanConfig:
    """Plans of footsteps on known ground."""

    stride: Positive  #: Nominal length of a step [m]
    aside: Positive  #: Largest distance of footholds from the line to either side [m]
    shift: Positive  #: Distance of the line to the parallel lines that are also tried [m]
    short_way: Positive  #: Length below which a plan is compared with plans along the parallel lines [m]
    arrived: Positive  #: Distance to the end of the line at which a plan is complete [m]
    level: Positive  #: Height difference above which ground is on another level [m]
    stray: Positive  #: Number of cells off a level from which ground is not level; higher cells count by height
    #: Number of standard deviations beyond `level` up to which a height does not bar a detour [-]
    doubt: NonNegative
    lowest: Annotated[float, Field(ge=0.0, le=50.0)]  #: Percentile of known heights that is the lowest ground [%]
    changed: Share  #: Share of changed ground under a step above which its plan is void [-]
    passed: Share  #: Largest height that a foot steps over, as a share of `reach.rise` [-]
    beside: Positive  #: Largest distance along the line between feet before and after a step to another level [m]
    together: Positive  #: The same at the end of a plan [m]
    retreat: NonNegative  #: Distance by which the feet may step back if a leg would meet ground close ahead [m]
    comfort: Positive  #: Room ahead and back from which an edge has no cost [m]
    inside: NonNegative  #: Margin of planned steps to the limits of the reach [m]
    stance: Positive  #: Largest deviation from the nominal stance at the end of a plan, beyond the sole width [m]
    sole: SoleConfig
    costs: CostsConfig


@dataclass(frozen=True, slots=True, config=STRICT)
class GroundConfig:
    """Walks on known ground."""

    watch: WatchConfig
    route: RouteConfig
    plan: PlanConfig
