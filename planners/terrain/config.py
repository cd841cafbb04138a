"""Schema of ``planners/config/terrain_map.yaml``."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Count, NonNegative, Positive, Proportion


@dataclass(frozen=True, slots=True, config=STRICT)
class BodyConfig:
    """Capsules for the removal of points on the robot."""

    margin: NonNegative  #: Margin around the hulls of the profile [m]
    foot: Positive  #: Radius of the capsule along each sole [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class FusionConfig:
    """Fusion of measurements into heights."""

    attitude: NonNegative  #: Standard deviation of the direction of a ray [rad]
    floor: Positive  #: Least standard deviation of a height, however many points a cell has [m]
    layer: Positive  #: Depth below the highest point of a cell, in deviations, beyond which a point is ignored [-]
    gate: Positive  #: Gate within which a measurement agrees with a cell, in standard deviations [-]
    disagree: Positive  #: Share of the squared error of a measurement outside the gate, added to the variance [-]
    drift: NonNegative  #: Growth of the variance of a height with time [m^2/s]
    step: NonNegative  #: Growth of the variance of a height with each change of the stance foot [m^2]
    variance_max: Positive  #: Variance above which a cell is unknown [m^2]
    clear: Positive  #: Distance below a cell, beyond 3 standard deviations, at which a ray clears it [m]
    clear_stride: Count  #: Stride of the rays that are traced to clear cells [1]


@dataclass(frozen=True, slots=True, config=STRICT)
class FeetConfig:
    """Soles as height measurements, for the Kalman filter of the common offset of the sensor heights."""

    period: Positive  #: Longest time between two updates of the feet, with or without clouds [s]
    limit: Positive  #: Height difference between sole and map beyond which nothing is corrected [m]
    bias: Positive  #: Initial standard deviation of the offset of the sensor heights [m]
    drift: Positive  #: Standard deviation of the change of the offset between two touchdowns [m]
    below: Positive  #: Standard deviation of the height of a sole above the map below it [m]
    ahead: Positive  #: Standard deviation of the height of standing soles above level ground ahead of them [m]
    distance: Positive  #: Length of that ground, from the toes [m]
    known: Proportion  #: Least share of that ground that must be known [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class PatchConfig:
    """Detection of planar patches."""

    window: Annotated[int, Field(ge=3, le=25, multiple_of=1)]  #: Cells along an edge of the fitted square, odd [1]
    roughness: Positive  #: Largest RMS deviation of that square from its plane [m]
    slope: Annotated[float, Field(gt=0.0, lt=1.57)]  #: Largest slope of a plane [rad]
    bend: Positive  #: Largest angle between the normals of a cell and of its patch [rad]
    thickness: Positive  #: Largest deviation of the height of a cell from the plane of its patch [m]
    area: Positive  #: Least area of a polygon [m^2]
    slack: Count  #: Cells by which a convex polygon may reach beyond its patch [1]
    pieces: Count  #: Largest number of polygons of a patch [1]

    def __post_init__(self) -> None:
        if self.window % 2 == 0:
            raise ValueError(f"window {self.window} is even: no cell is in its middle")


@dataclass(frozen=True, slots=True, config=STRICT)
class TerrainMapConfig:
    """Settings of the terrain mapper."""

    cell: Annotated[float, Field(ge=0.005, le=0.2)]  #: Edge length of a cell [m]
    length: Annotated[float, Field(ge=0.5, le=10.0)]  #: Edge length of the map [m]
    height_max: Positive  #: Height above the stance sole beyond which points are ignored [m]
    depth_max: Positive  #: Depth below the stance sole beyond which points are ignored [m]
    given_deviation: Positive  #: Standard deviation of given heights [m]
    body: BodyConfig
    fusion: FusionConfig
    feet: FeetConfig
    patches: PatchConfig

    @property
    def cells(self) -> int:
        """Number of cells along an edge of the map."""
        return round(self.length / self.cell)
