"""State types shared by every law: frozen records of float64 arrays.

Those that every tick makes anew are structs of msgspec, which are made in a fifth of the time that a frozen dataclass
takes; ``msgspec.structs.replace`` copies one with other values.

Conventions: SI units and radians; quaternions xyzw; W is the world (odom) frame, B the floating base, S a sole.
Joint vectors follow ``RobotModel.joint_names``; feet follow ``RobotModel.feet`` (left, right). Six-vectors are
linear, then angular. Arrays handed out in these types are never written to by whoever receives them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

FOOT_NAMES = ("left", "right")
"""Order of the feet in every array with one row per foot."""


class SensorData(Struct, frozen=True):
    """One sample of everything the robot can measure.

    Attributes:
        t: Measurement stamp on the robot's own clock [s].
        q: Joint positions (nj,) [rad].
        v: Joint velocities (nj,) [rad/s].
        tau: Measured joint torques (nj,) [N.m].
        gyro: Angular velocity of the IMU in the IMU frame (3,) [rad/s].
        accel: Specific force at the IMU in the IMU frame (3,) [m/s^2]; reads +g along up at rest (REP-145).
        wrenches: Ground reaction on each foot, in its sole frame at its sole origin (2, 6) [N, N.m].
    """

    t: float
    q: Vector
    v: Vector
    tau: Vector
    gyro: Vector
    accel: Vector
    wrenches: Matrix


class ContactState(Struct, frozen=True):
    """What one foot feels.

    Attributes:
        active: Whether the foot bears load.
        wrench: Ground reaction in the sole frame, at the sole origin (6,) [N, N.m].
    """

    active: bool
    wrench: Vector


class RobotState(Struct, frozen=True):
    """Configuration, velocity, torque and contacts at one instant.

    Attributes:
        t: Stamp of the measurements it comes from [s].
        q: Configuration in Pinocchio's order: base position in W (3), base quaternion xyzw (4), joints (nj) [m, rad].
        v: Velocity in Pinocchio's order: base twist expressed in B, linear then angular (6), joints (nj)
            [m/s, rad/s].
        tau: Measured joint torques (nj,) [N.m].
        contacts: One per foot, in the order of ``FOOT_NAMES``.
    """

    t: float
    q: Vector
    v: Vector
    tau: Vector
    contacts: tuple[ContactState, ContactState]

    @property
    def base_position(self) -> Vector:
        """Origin of B in W (3,) [m]."""
        return self.q[:3]

    @property
    def base_quaternion(self) -> Vector:
        """Orientation of B in W, xyzw (4,)."""
        return self.q[3:7]

    @property
    def base_linear_velocity(self) -> Vector:
        """Velocity of B's origin relative to W, expressed in B (3,) [m/s]."""
        return self.v[:3]

    @property
    def base_angular_velocity(self) -> Vector:
        """Angular velocity of B relative to W, expressed in B (3,) [rad/s]."""
        return self.v[3:6]

    @property
    def joint_positions(self) -> Vector:
        """Joint positions (nj,) [rad]."""
        return self.q[7:]

    @property
    def joint_velocities(self) -> Vector:
        """Joint velocities (nj,) [rad/s]."""
        return self.v[6:]


class PushEstimate(Struct, frozen=True):
    """What acts on the robot besides gravity and the ground, as the force observer has it.

    Attributes:
        force: In W; zero inside the dead-band (3,) [N].
        moment: About the CoM, in W; zero inside the dead-band of the force (3,) [N.m].
        active: Whether a push is detected.
        impulse: Integral of the force since the push began; kept until the force is back in the dead-band and the
            push is over (3,) [N.s].
    """

    force: Vector
    moment: Vector
    active: bool
    impulse: Vector


class CentroidalState(Struct, frozen=True):
    """The robot as one body, in W.

    Attributes:
        com: Centre of mass (3,) [m].
        com_velocity: (3,) [m/s].
        angular_momentum: About the CoM (3,) [kg.m^2/s].
        dcm: Divergent component of motion above the lower sole, x and y (2,) [m].
        zmp: Zero-moment point of the low-passed sole wrenches, at the height of the lower sole, x and y (2,) [m].
    """

    com: Vector
    com_velocity: Vector
    angular_momentum: Vector
    dcm: Vector
    zmp: Vector


class Reference(Struct, frozen=True):
    """What the whole-body controller is to track at one instant.

    Good for that tick: the arrays of soles and posture may be its maker's own, which the next tick overwrites.

    Attributes:
        com: CoM position in W (3,) [m].
        com_velocity: CoM velocity in W (3,) [m/s].
        com_acceleration: CoM feed-forward acceleration in W (3,) [m/s^2].
        base_orientation: Rotation of B in W (3, 3).
        torso_orientation: Rotation of the torso frame in W (3, 3).
        posture: Joint positions (nj,) [rad].
        posture_velocity: Joint velocities (nj,) [rad/s].
        posture_acceleration: Joint accelerations (nj,) [rad/s^2].
        sole_rotations: Rotation of each sole in W (2, 3, 3): the foothold in contact, else where to swing.
        sole_positions: Position of each sole in W (2, 3) [m]: the foothold in contact, else where to swing.
        sole_velocities: Wanted spatial velocity of each sole, world-aligned at the sole (2, 6) [m/s, rad/s].
        sole_accelerations: Wanted acceleration of each sole, world-aligned at the sole (2, 6) [m/s^2, rad/s^2].
        contacts: Whether each foot is planned to bear load.
        load: How far each foot in contact may be loaded, as a share of its largest normal force; their ratio is how
            the weight is to be shared (2,) [-].
        dcm: DCM in W, x and y (2,) [m]; None where the CoM itself is the reference (standing).
        dcm_velocity: Its rate (2,) [m/s]; None where ``dcm`` is.
        heading_rate: Wanted angular velocity of base and torso about the vertical [rad/s].
        cmp_offset: How far the line of the ground force is planned to pass from the CoP, for the angular momentum that
            the swing leg takes, x and y in W (2,) [m]; None for not at all.
        sole_areas: x_min, x_max, y_min, y_max of the part of each sole that bears, in its frame (2, 4) [m]; None for
            the whole soles.
    """

    com: Vector
    com_velocity: Vector
    com_acceleration: Vector
    base_orientation: Matrix
    torso_orientation: Matrix
    posture: Vector
    posture_velocity: Vector
    posture_acceleration: Vector
    sole_rotations: NDArray[np.float64]
    sole_positions: Matrix
    sole_velocities: Matrix
    sole_accelerations: Matrix
    contacts: tuple[bool, bool] = (True, True)
    load: tuple[float, float] = (1.0, 1.0)
    dcm: Vector | None = None
    dcm_velocity: Vector | None = None
    heading_rate: float = 0.0
    cmp_offset: Vector | None = None
    sole_areas: Matrix | None = None


class JointCommand(Struct, frozen=True):
    """Set-point for the joint drivers, which apply kp (q - q_meas) + kd (v - v_meas) + tau.

    Attributes:
        q: Joint positions (nj,) [rad].
        v: Joint velocities (nj,) [rad/s].
        tau: Feed-forward torques (nj,) [N.m].
    """

    q: Vector
    v: Vector
    tau: Vector


class SolveStatus(Enum):
    """How the command of one tick came about."""

    OPTIMAL = "optimal"
    RELAXED = "relaxed"
    """Infeasible as posed; solved with softened limits in the same tick."""
    FALLBACK_SOLVER = "fallback_solver"
    """The first solver's answer failed its KKT check; the second one's passed."""
    HELD = "held"
    """No usable answer: the previous torques were repeated."""
    DAMPED = "damped"
    """No usable answer for too long: damping only."""


class ControlResult(Struct, frozen=True):
    """One tick of the whole-body controller.

    Attributes:
        command: Set-point for the drivers.
        status: How the command came about.
        residual: Largest KKT residual of the QP (stationarity, feasibility, complementarity), scaled.
        acceleration: Generalised acceleration of the solution (nv,) [m/s^2, rad/s^2].
        wrenches: Contact wrench of each foot in its sole frame (2, 6) [N, N.m]; zero when not in contact.
        com: Measured CoM in W (3,) [m].
        dcm: Measured divergent component of motion in W, x and y (2,) [m].
        zmp: Commanded zero-moment point in W, x and y (2,) [m].
        solve_time: Duration of the QP solve [s]; for reports only, never used by a law.
    """

    command: JointCommand
    status: SolveStatus
    residual: float
    acceleration: Vector
    wrenches: Matrix
    com: Vector
    dcm: Vector
    zmp: Vector
    solve_time: float = 0.0


@dataclass(frozen=True, slots=True)
class JointTrajectory:
    """A joint trajectory keyed by name, as trajectory_msgs/JointTrajectory carries it.

    Attributes:
        joint_names: Names of the columns, any order, no duplicates.
        times: Time from start of each point, strictly increasing (n,) [s].
        positions: (n, k) [rad].
        velocities: (n, k) [rad/s], or None.
        efforts: Feed-forward torques (n, k) [N.m], or None.
    """

    joint_names: tuple[str, ...]
    times: Vector
    positions: Matrix
    velocities: Matrix | None = None
    efforts: Matrix | None = None


class Mode(Enum):
    """What the robot is doing; see the mode machine in ``controllers/supervisor.py``."""

    OFF = "off"
    DAMP = "damp"
    STAND = "stand"
    WALK = "walk"
    MOTION = "motion"


@dataclass(frozen=True, slots=True)
class CommandReply:
    """Answer to a command or mode request.

    Attributes:
        accepted: Whether it is being carried out.
        reason: Why not, or what happens now; never empty.
        details: Numbers that explain the answer, by name.
    """

    accepted: bool
    reason: str
    details: dict[str, float] = field(default_factory=dict)
