"""Schema of ``planners/config/terrain_map.yaml``, which has units and meanings."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Count, NonNegative, Positive, Proportion


@dataclass(frozen=True, slots=True, config=STRICT)
class BodyConfig:
    """Shapes within which a point belongs to the robot."""

    margin: NonNegative  #: The hulls of the profile are larger by this [m]
    foot: Positive  #: Radius of the capsule along each sole [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class FusionConfig:
    """How measurements become heights."""

    attitude: NonNegative  #: Uncertainty of the direction of a ray [rad]
    floor: Positive  #: Standard deviation that is left however many points a cell has [m]
    layer: Positive  #: Points lower than so many deviations under a cell's highest are below an edge [-]
    gate: Positive  #: Deviations up to which a measurement agrees with a cell [-]
    disagree: Positive  #: Share of the squared error of a measurement that disagrees, added to the variance [-]
    drift: NonNegative  #: Growth of a height's variance in time [m^2/s]
    step: NonNegative  #: Growth of a height's variance with each change of the stance foot [m^2]
    variance_max: Positive  #: A cell less certain than this is unknown [m^2]
    clear: Positive  #: A ray that passes this far below a cell's height empties it [m]
    clear_stride: Count  #: Every so many rays are followed for that [1]


@dataclass(frozen=True, slots=True, config=STRICT)
class FeetConfig:
    """Soles as measurements of the ground. The error of the heights that are seen is estimated by a Kalman filter."""

    period: Positive  #: The feet are followed at least so often, with or without clouds [s]
    limit: Positive  #: Larger differences of a sole to the map shift nothing [m]
    bias: Positive  #: Error of the heights that are seen, at first: standard deviation [m]
    drift: Positive  #: Its change from a landing to the next: standard deviation [m]
    below: Positive  #: Error of the height of a sole above the map below it: standard deviation [m]
    ahead: Positive  #: The same, of a standing sole above level ground in front of it: standard deviation [m]
    distance: Positive  #: How far in front of the toes that ground reaches [m]
    known: Proportion  #: Least share of it that must be known [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class PatchConfig:
    """What counts as planar."""

    window: Annotated[int, Field(ge=3, le=25, multiple_of=1)]  #: Cells along an edge of the fitted square, odd [1]
    roughness: Positive  #: Largest RMS deviation from the plane of that square [m]
    slope: Annotated[float, Field(gt=0.0, lt=1.57)]  #: Steepest plane [rad]
    bend: Positive  #: Largest angle between the normals of a cell and of its patch [rad]
    thickness: Positive  #: Largest distance of a cell's height from the plane of its patch [m]
    area: Positive  #: Smallest polygon [m^2]
    slack: Count  #: Cells by which a convex polygon may reach beyond its patch [1]
    pieces: Count  #: Most polygons of a patch [1]

    def __post_init__(self) -> None:
        if self.window % 2 == 0:
            raise ValueError(f"window {self.window} is even: no cell is in its middle")


@dataclass(frozen=True, slots=True, config=STRICT)
class TerrainMapConfig:
    """Settings of the terrain mapper."""

    cell: Annotated[float, Field(ge=0.005, le=0.2)]  #: Edge of a cell [m]
    length: Annotated[float, Field(ge=0.5, le=10.0)]  #: Edge of the map [m]
    height_max: Positive  #: Points higher above the stance sole are no ground [m]
    depth_max: Positive  #: Points deeper below it are none [m]
    given_deviation: Positive  #: Error of given heights: standard deviation [m]
    body: BodyConfig
    fusion: FusionConfig
    feet: FeetConfig
    patches: PatchConfig

    @property
    def cells(self) -> int:
        """Cells along an edge of the map."""
        return round(self.length / self.cell)
