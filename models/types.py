"""State types shared by all laws: frozen records of float64 arrays.

Types created on every tick are msgspec structs, which are five times faster than frozen dataclasses;
``msgspec.structs.replace`` copies one with other values.

Conventions: SI units and radians; quaternions xyzw; W is the world (odom) frame, B the floating base, S a sole.
Joint vectors follow ``RobotModel.joint_names``; feet follow ``RobotModel.feet`` (left, right). Six-vectors are
linear, then angular. The arrays are read-only by convention.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum, StrEnum

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Vector3 = tuple[float, float, float]
Velocity = Vector3  #: Walking velocity of the body in its frame: forward [m/s], left [m/s], turn [rad/s]
STILL: Velocity = (0.0, 0.0, 0.0)


class SensorData(Struct, frozen=True):
    """One sample of all sensors."""

    t: float  # measurement stamp on the robot's clock [s]
    q: Vector  # joint positions (nj,) [rad]
    v: Vector  # joint velocities (nj,) [rad/s]
    tau: Vector  # measured joint torques (nj,) [N.m]
    gyro: Vector  # angular velocity of the IMU in the IMU frame (3,) [rad/s]
    accel: Vector  # specific force at the IMU in the IMU frame (3,) [m/s^2]; +g along up at rest (REP-145)
    wrenches: Matrix  # ground reaction on each foot, in the sole frame at the sole origin (2, 6) [N, N.m]


class ContactState(Struct, frozen=True):
    """Contact of one foot."""

    active: bool  # the foot bears load
    wrench: Vector  # ground reaction in the sole frame, at the sole origin (6,) [N, N.m]


class RobotState(Struct, frozen=True):
    """Configuration, velocity, torque and contacts at one instant."""

    t: float  # stamp of the measurements [s]
    q: Vector  # base position in W (3), base quaternion xyzw (4), joints (nj) [m, rad]
    v: Vector  # base twist in B, linear then angular (6), joints (nj) [m/s, rad/s]
    tau: Vector  # measured joint torques (nj,) [N.m]
    contacts: tuple[ContactState, ContactState]  # one per foot, in the order of ``FOOT_NAMES``
    friction: float = math.inf  # Coulomb coefficient of the ground under the soles; infinite when unknown [-]


class PushEstimate(Struct, frozen=True):
    """External force on the robot besides gravity and the ground, estimated by the force observer."""

    force: Vector  # in W; zero inside the dead-band (3,) [N]
    moment: Vector  # about the CoM, in W; zero inside the dead-band of the force (3,) [N.m]
    active: bool  # a push is detected
    impulse: Vector  # integral of the force since the push began, held until the push ends (3,) [N.s]


class CentroidalState(Struct, frozen=True):
    """Centroidal state of the robot, in W."""

    com: Vector  # (3,) [m]
    com_velocity: Vector  # (3,) [m/s]
    angular_momentum: Vector  # about the CoM (3,) [kg.m^2/s]
    dcm: Vector  # divergent component of motion relative to the height of the lower sole, x and y (2,) [m]
    zmp: Vector  # of the low-passed sole wrenches, at the height of the lower sole, x and y (2,) [m]


class Reference(Struct, frozen=True):
    """Reference of the whole-body controller at one instant.

    Valid for one tick: the next tick may overwrite the arrays of soles and posture.
    """

    com: Vector  # in W (3,) [m]
    com_velocity: Vector  # in W (3,) [m/s]
    com_acceleration: Vector  # feed-forward, in W (3,) [m/s^2]
    base_orientation: Matrix  # rotation of B in W (3, 3)
    torso_orientation: Matrix  # rotation of the torso frame in W (3, 3)
    posture: Vector  # joint positions (nj,) [rad]
    posture_velocity: Vector  # (nj,) [rad/s]
    posture_acceleration: Vector  # (nj,) [rad/s^2]
    sole_rotations: NDArray[np.float64]  # of each sole in W: foothold in contact, else swing reference (2, 3, 3)
    sole_positions: Matrix  # likewise (2, 3) [m]
    sole_velocities: Matrix  # spatial, world-aligned at the sole (2, 6) [m/s, rad/s]
    sole_accelerations: Matrix  # world-aligned at the sole (2, 6) [m/s^2, rad/s^2]
    contacts: tuple[bool, bool] = (True, True)  # each foot is planned to bear load
    load: tuple[float, float] = (1.0, 1.0)  # allowed share of each foot's maximum force, in the ratio of the loads [-]
    load_alone: float = 0.0  # minimum share of the weight on the foot in single support [-]
    dcm: Vector | None = None  # in W, x and y (2,) [m]; None when the CoM is the reference (standing)
    dcm_velocity: Vector | None = None  # (2,) [m/s]; None when ``dcm`` is None
    heading_rate: float = 0.0  # of base and torso about the vertical [rad/s]
    cmp_offset: Vector | None = None  # CMP minus CoP for the angular momentum of the swing leg, in W (2,) [m]; optional
    sole_areas: Matrix | None = None  # bearing rectangle of each sole (x_min, x_max, y_min, y_max) [m]; None: whole
    momentum: float = 1.0  # allowed share of the maximum distance of the CMP beyond the edge of the support [-]
    stiffness: float = 1.0  # share of the stiff gains of stepping; 0 in an undisturbed slow walk [-]
    urgent: bool = False  # the step recovers from a disturbance
    levels: tuple[float, float] = (0.0, 0.0)  # heights: ground under the CoM, ZMP over the bearing sole(s) [m]


class JointCommand(Struct, frozen=True):
    """Setpoint for the joint drives, which apply kp (q - q_meas) + kd (v - v_meas) + tau.

    Torque control is the special case without gains: ``JointCommand.torque``.
    """

    q: Vector  # (nj,) [rad]
    v: Vector  # (nj,) [rad/s]
    tau: Vector  # feed-forward (nj,) [N.m]
    kp: Vector | None = None  # (nj,) [N.m/rad]; from the robot's profile when None
    kd: Vector | None = None  # (nj,) [N.m.s/rad]; from the robot's profile when None

    @classmethod
    def torque(cls, tau: Vector) -> JointCommand:
        """Command of torques (nj,) [N.m] only."""
        zero = np.zeros_like(tau)
        return cls(zero, zero, tau, zero, zero)


class SolveStatus(Enum):
    """Origin of the command of one tick."""

    OPTIMAL = "optimal"
    RELAXED = "relaxed"  # infeasible; solved with softened limits in the same tick
    FALLBACK_SOLVER = "fallback_solver"  # the first solver failed the KKT check; the second passed it
    HELD = "held"  # no usable solution: previous torques repeated
    DAMPED = "damped"  # no usable solution for too long: damping only


class ControlResult(Struct, frozen=True):
    """One tick of the whole-body controller."""

    command: JointCommand
    status: SolveStatus  # origin of the command
    residual: float  # largest KKT residual of the QP (stationarity, feasibility, complementarity), scaled
    acceleration: Vector  # generalised acceleration of the solution (nv,) [m/s^2, rad/s^2]
    wrenches: Matrix  # contact wrench of each foot in its sole frame (2, 6) [N, N.m]; zero without contact
    com: Vector  # measured, in W (3,) [m]
    dcm: Vector  # measured, in W, x and y (2,) [m]
    zmp: Vector  # commanded, in W, x and y (2,) [m]
    solve_time: float = 0.0  # of the QP [s]; for reports only, never used by a law


@dataclass(frozen=True, slots=True)
class JointTrajectory:
    """A joint trajectory keyed by name, as in trajectory_msgs/JointTrajectory."""

    joint_names: tuple[str, ...]  # names of the columns, any order, no duplicates
    times: Vector  # from the start, strictly increasing (n,) [s]
    positions: Matrix  # (n, k) [rad]
    velocities: Matrix | None = None  # (n, k) [rad/s], or None
    efforts: Matrix | None = None  # feed-forward torques (n, k) [N.m], or None


class Mode(StrEnum):
    """Mode of the robot; see the mode machine in ``controllers/safety/supervisor.py``."""

    OFF = "off"
    DAMP = "damp"
    STAND = "stand"
    WALK = "walk"
    MOTION = "motion"


@dataclass(frozen=True, slots=True)
class CommandReply:
    """Reply to a command or mode request."""

    accepted: bool  # it is executed
    reason: str  # reason of a refusal, or the accepted action; never empty
    details: dict[str, float] = field(default_factory=dict)  # numbers that explain the reply, by name
