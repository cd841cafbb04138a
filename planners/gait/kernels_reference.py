"""Compiled geometry of a gait's reference: rotations of soles, base and torso, and the motion of the swing foot."""

from __future__ import annotations

import math

from models.compiled import njit
from models.types import Matrix, Vector
from planners.gait.kernels_steps import Point, wrap

Place = tuple[float, float, float, float]
"""x, y, z [m] and heading [rad] in W."""


@njit("void(float64, float64, float64, float64[:, ::1])", cache=True)
def sole_rotation(yaw: float, rise_x: float, rise_y: float, rotation: Matrix) -> None:
    """Rotation of a sole that heads along ``yaw`` on a slope that rises by so much along x and y of W, into (3, 3)."""
    size = math.sqrt(rise_x * rise_x + rise_y * rise_y + 1.0)
    nx, ny, nz = -rise_x / size, -rise_y / size, 1.0 / size
    c, s = math.cos(yaw), math.sin(yaw)
    part = c * nx + s * ny
    ax, ay, az = c - part * nx, s - part * ny, -part * nz
    length = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    rotation[0, 0], rotation[1, 0], rotation[2, 0] = ax, ay, az
    rotation[0, 1], rotation[1, 1], rotation[2, 1] = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    rotation[0, 2], rotation[1, 2], rotation[2, 2] = nx, ny, nz


@njit(
    "void(UniTuple(UniTuple(float64, 4), 2), float64[:, ::1], int64, float64[:, ::1], float64[::1], float64[:, :, ::1],"
    " float64[:, :, ::1], float64[:, ::1], float64[:, :, ::1], float64[:, :, ::1])",
    cache=True,
)
def place_bodies(
    places: tuple[Place, Place],
    tilts: Matrix,
    foot: int,
    motion: Matrix,
    tilt: Vector,
    upright: Matrix,
    rotations: Matrix,
    positions: Matrix,
    motions: Matrix,
    bodies: Matrix,
) -> None:
    """Soles, base and torso.

    Args:
        places: Of the planted soles.
        tilts: Slope under each (2, 2) [-].
        foot: The foot that swings; -1 for none.
        motion: Its position, velocity and acceleration: x, y, z, yaw (3, 4).
        tilt: Slope of its sole (2,) [-].
        upright: Rotations of base and torso at heading 0 (2, 3, 3).
        rotations: Out, of the soles (2, 3, 3).
        positions: Out, of the soles (2, 3) [m].
        motions: Out: velocity of each sole, and acceleration of each (2, 2, 6).
        bodies: Out, rotations of base and torso: at the mean heading of the soles (2, 3, 3).
    """
    motions[:] = 0.0
    first, second = places[0][3], places[1][3]
    for i in range(2):
        x, y, z, yaw = places[i]
        rise_x, rise_y = tilts[i, 0], tilts[i, 1]
        if i == foot:
            x, y, z, yaw = motion[0, 0], motion[0, 1], motion[0, 2], motion[0, 3]
            rise_x, rise_y = tilt[0], tilt[1]
            for k in range(2):
                for axis in range(3):
                    motions[k, i, axis] = motion[1 + k, axis]
                motions[k, i, 5] = motion[1 + k, 3]
            if i == 0:
                first = yaw
            else:
                second = yaw
        positions[i, 0], positions[i, 1], positions[i, 2] = x, y, z
        sole_rotation(yaw, rise_x, rise_y, rotations[i])
    turn = first + 0.5 * wrap(second - first)
    c, s = math.cos(turn), math.sin(turn)
    for body in range(2):
        for k in range(3):
            x, y = upright[body, 0, k], upright[body, 1, k]
            bodies[body, 0, k], bodies[body, 1, k], bodies[body, 2, k] = (
                c * x - s * y,
                s * x + c * y,
                upright[body, 2, k],
            )


@njit(
    "float64(UniTuple(UniTuple(float64, 2), 2), float64[:, ::1], int64, float64[::1], float64, float64, float64,"
    " float64)",
    cache=True,
)
def height_in_reach(
    places: tuple[Point, Point],
    under: Matrix,
    swinging: int,
    com: Vector,
    lean: float,
    yaw: float,
    leg: float,
    standing: float,
) -> float:
    """CoM height at which no leg is longer than when the robot stands [m].

    A planted foot is as far from under its hip as it is measured, and will be as far as ``lean`` of the way between the
    feet when the swing foot lands.

    Args:
        places: Of the footholds in W [m].
        under: Where each sole is from the CoM when the robot stands at heading 0 (2, 2) [m].
        swinging: The foot in the air; -1 for none.
        com: Measured CoM (3,) [m].
        lean: Share of the way between the feet at which the body will be when the swing foot lands [-].
        yaw: Heading [rad].
        leg: Length of a leg [m].
        standing: CoM height of the robot that stands [m].
    """
    c, s = math.cos(yaw), math.sin(yaw)
    left_x, left_y = (
        places[0][0] - (c * under[0, 0] - s * under[0, 1]),
        places[0][1] - (s * under[0, 0] + c * under[0, 1]),
    )
    right_x, right_y = (
        places[1][0] - (c * under[1, 0] - s * under[1, 1]),
        places[1][1] - (s * under[1, 0] + c * under[1, 1]),
    )
    x, y = left_x - right_x, left_y - right_y
    square = lean * lean * (x * x + y * y)
    if swinging != 0:
        x, y = left_x - com[0], left_y - com[1]
        square = max(square, x * x + y * y)
    if swinging != 1:
        x, y = right_x - com[0], right_y - com[1]
        square = max(square, x * x + y * y)
    return standing - leg + math.sqrt(max(leg * leg - square, 0.25 * leg * leg))
