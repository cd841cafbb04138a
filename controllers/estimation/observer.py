"""Momentum observer: pushes on the robot, and sole wrenches from the leg torques."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.estimation.config import ObserverConfig
from controllers.estimation.momentum import Dynamics, Momentum, generalised_momentum, read_dynamics
from models.constants import COM_HEIGHT_MIN
from models.numerics.cholesky import factorise, solve_factored
from models.numerics.compiled import njit
from models.numerics.so3 import rotate, rotate_transposed
from models.robot_model import RobotModel
from models.types import CentroidalState, Matrix, PushEstimate, Vector

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class ObserverGains(NamedTuple):
    """``ObserverConfig`` in SI units (forces in N, rates in 1/s), and the weight."""

    push_rate: float
    joint_rate: float
    damping: float
    moment_arm: float
    friction_speed: float
    weight: float
    dead_band: float
    detect_on: float
    detect_off: float
    on_time: float
    off_time: float
    offset_time: float


class ObserverState(NamedTuple):
    """Low-passes and detection of ``ForceObserver``; six-vectors are force, then moment about the CoM, in W."""

    base: Array  # net external wrench without gravity, feet included (6,)
    joints: Array  # external torque on each joint (nj,) [N.m]
    past: Array  # momentum of the last step: linear, then angular about the CoM (6,)
    past_joints: Array  # generalised momentum of the joints in the last step (nj,)
    feet: Array  # wrench of both soles after both low-passes (6,)
    estimated: Array  # wrench of each sole from the leg torques, in its frame (2, 6)
    measured: Array  # reading of each foot sensor after the low-pass of the joints, in the sole frames (2, 6)
    lagged: Array  # ``base`` after the low-pass of the joints (6,)
    push: Array  # (6,)
    offset: Array  # learned offset of the push (6,)
    impulse: Array  # of the push (3,) [N.s]
    timer: Array  # time for which the condition of a change of ``active`` has held (1,) [s]
    active: Array  # 1 while a push is detected, else 0 (1,)
    centroid: Array  # CoM, its velocity, angular momentum about it (3, 3) [m, m/s, N.m.s]
    ground: Array  # height of the lower sole (1,) [m]


class Observer(NamedTuple):
    """Constants and state of ``ForceObserver``."""

    gains: ObserverGains
    legs: Index  # joints of each leg, padded with -1 (2, k)
    robot: Dynamics
    state: ObserverState


class ForceObserver:
    """Momentum observer: residual of the generalised momentum, for all rows.

    With p = M v and tau the joint torques minus friction, each row is a low-pass of the external torque on it::

        r' = K (p' - (C' v - g + tau) - r)

    p' is a difference of momenta, so no acceleration is needed. The six base rows are taken about the CoM in W, where
    C' v - g is the weight alone. The rows of a leg give the wrench of its sole, F = (J_leg')^+ r_leg, by damped least
    squares. The remainder of the base rows is the push::

        push = r_base - (wrenches of the soles at the CoM) - (learnt offset)

    All terms pass both low-passes, of the joints and of the push; otherwise walking would look like a push.

    ``base`` is the net external wrench without gravity, feet included, about the CoM in W (6,), ``joints`` the external
    torques (nj,). ``estimated`` and ``measured`` are the wrenches of the soles from leg torques and sensors, in the
    sole frames (2, 6).

    References:
        A. De Luca, A. Albu-Schaeffer, S. Haddadin, G. Hirzinger: Collision detection and safe reaction with the
        DLR-III lightweight manipulator arm. IROS 2006, eq. 9-12.
        J. Vorndamme, M. Schappler, S. Haddadin: Collision detection, isolation and identification for humanoids.
        ICRA 2017.
    """

    def __init__(self, model: RobotModel, config: ObserverConfig, gravity: float) -> None:
        self._robot = read_dynamics(model, gravity)
        self.weight = weight = model.mass * gravity
        self._gains = ObserverGains(
            push_rate=2.0 * math.pi * config.push_cutoff,
            joint_rate=2.0 * math.pi * config.joint_cutoff,
            damping=config.damping,
            moment_arm=config.moment_arm,
            friction_speed=config.friction_speed,
            weight=weight,
            dead_band=config.dead_band * weight,
            detect_on=config.detect_on * weight,
            detect_off=config.detect_off * weight,
            on_time=config.on_time,
            off_time=config.off_time,
            offset_time=config.offset_time,
        )
        nj = model.nj
        shapes = (6, nj, 6, nj, 6, (2, 6), (2, 6), 6, 6, 6, 3, 1, 1, (3, 3), 1)
        self.state = ObserverState(*(np.zeros(shape) for shape in shapes))
        self.base, self.joints = self.state.base, self.state.joints
        self.estimated, self.measured = self.state.estimated, self.state.measured
        legs = np.full((2, max(len(foot.joint_ids_v) for foot in model.feet)), -1, dtype=np.int64)
        for row, foot in zip(legs, model.feet, strict=True):
            row[: len(foot.joint_ids_v)] = np.asarray(foot.joint_ids_v) - 6
        self.memory = Observer(self._gains, legs, self._robot, self.state)

    def reset(self, q: Vector, v: Vector, tau: Vector, measured: Matrix, fault: Vector) -> None:
        """Reset to a steady state: forces in balance, no push; arguments as for ``update``."""
        for array in self.state:
            array[...] = 0.0
        self.update(q, v, tau, measured, fault, 0.0)

    def update(self, q: Vector, v: Vector, tau: Vector, measured: Matrix, fault: Vector, dt: float) -> None:
        """Advance by ``dt`` [s], 0 to start in a steady state, with q (nq,), v (nv,), tau (nj,).

        ``measured`` are readings in the sole frames (2, 6); leg torques replace them where ``fault`` is nonzero (2,).
        """
        observe(q, v, tau, measured, fault, False, dt, self.memory)

    @property
    def push(self) -> PushEstimate:
        """The present push."""
        push = self.state.push
        quiet = float(push[:3] @ push[:3]) <= self._gains.dead_band**2
        shown = np.zeros(6) if quiet else push.copy()
        return PushEstimate(shown[:3], shown[3:], bool(self.state.active[0]), self.state.impulse.copy())

    @property
    def centroidal(self) -> CentroidalState:
        """CoM, DCM, ZMP and momentum of the last state, from the last step of the observer."""
        feet, gravity = self.state.feet, self._robot.gravity
        com, com_velocity, angular_momentum = self.state.centroid.copy()
        height = max(float(com[2] - self.state.ground[0]), COM_HEIGHT_MIN)
        dcm = com[:2] + com_velocity[:2] / np.sqrt(gravity / height)
        # ZMP: point on the ground where the horizontal moment of the soles vanishes; ``feet`` is about the CoM.
        load = max(float(feet[2]), 0.05 * self.weight)
        zmp = com[:2] + np.array([-feet[4] - height * feet[0], feet[3] - height * feet[1]]) / load
        return CentroidalState(com=com, com_velocity=com_velocity, angular_momentum=angular_momentum, dcm=dcm, zmp=zmp)


@njit(cache=True)
def _leg_wrench(
    torques: Array, columns: Index, momentum: Momentum, foot: int, damping: float, arm: float, out: Array
) -> None:
    """Wrench in the sole frame from the external torques of one leg, by damped least squares.

    With x = (f, m / arm) in W and the rows of J scaled accordingly, (J J' + damping^2 I) x = J torques, by Cholesky.
    """
    axes, origins, sole = momentum.axes, momentum.origins, momentum.sole_positions[foot]
    rotation = momentum.sole_rotations[foot]
    normal = np.zeros((6, 6))
    solution = np.zeros(6)
    row = np.empty(6)
    for k in range(columns.shape[0]):
        n = columns[k]
        if n < 0:
            break
        axis = axes[n + 1]
        dx, dy, dz = sole[0] - origins[n + 1, 0], sole[1] - origins[n + 1, 1], sole[2] - origins[n + 1, 2]
        row[0] = axis[1] * dz - axis[2] * dy
        row[1] = axis[2] * dx - axis[0] * dz
        row[2] = axis[0] * dy - axis[1] * dx
        for i in range(3):
            row[3 + i] = arm * axis[i]
        for i in range(6):
            solution[i] += row[i] * torques[n]
            for j in range(i + 1):
                normal[i, j] += row[i] * row[j]
    for i in range(6):
        normal[i, i] += damping * damping
    factorise(normal)
    solve_factored(normal, solution.reshape((6, 1)))
    for i in range(3):
        solution[3 + i] *= arm
    rotate_transposed(rotation, solution[0:3], out[0:3])
    rotate_transposed(rotation, solution[3:6], out[3:6])


@njit(cache=True)
def _detect_push(dt: float, doubtful: bool, gains: ObserverGains, state: ObserverState) -> None:
    """Learns the offset, detects the push with hysteresis, and integrates its impulse.

    Offsets of the foot sensors and mass errors look like a permanent push. A residual within the dead-band is therefore
    learned as an offset, bounded by the dead-band, and subtracted. The error of a foot sensor in doubt looks like a
    push, so no push begins while ``doubtful``.
    """
    push, offset, impulse, timer = state.push, state.offset, state.impulse, state.timer
    for i in range(6):
        push[i] -= offset[i]
    size = math.sqrt(push[0] * push[0] + push[1] * push[1] + push[2] * push[2])
    active = state.active[0] > 0.0
    if doubtful and not active:
        timer[0] = 0.0
        impulse[:] = 0.0
        return
    if size < gains.detect_off if active else size > gains.detect_on:
        timer[0] += dt
        if timer[0] > (gains.off_time if active else gains.on_time):
            state.active[0], timer[0] = 0.0 if active else 1.0, 0.0
    else:
        timer[0] = 0.0
    if size > gains.dead_band:
        for i in range(3):
            impulse[i] += dt * push[i]
    elif not active:
        impulse[:] = 0.0
        learnt = 0.0
        for i in range(6):
            offset[i] += dt / gains.offset_time * push[i]
            learnt += offset[i] * offset[i] if i < 3 else 0.0
        if learnt > gains.dead_band * gains.dead_band:
            for i in range(6):
                offset[i] *= gains.dead_band / math.sqrt(learnt)


@njit(cache=True)
def observe(
    q: Array, v: Array, tau: Array, measured: Array, fault: Array, doubtful: bool, dt: float, observer: Observer
) -> None:
    """One step of ``ForceObserver.update``."""
    gains, legs, robot, state = observer
    momentum, speeds = generalised_momentum(q, v, robot), v[6:]
    push_gain, joint_gain = min(gains.push_rate * dt, 1.0), min(gains.joint_rate * dt, 1.0)
    base, joints, past, past_joints = state.base, state.joints, state.past, state.past_joints
    total, spin, com = momentum.linear, momentum.angular_momentum, momentum.com
    start = dt <= 0.0
    for n in range(joints.shape[0]):
        known = momentum.joint_rate[n] + tau[n] - robot.damping[n] * speeds[n]
        known -= robot.friction[n] * math.tanh(speeds[n] / gains.friction_speed)
        if start:
            joints[n] = -known
        else:
            joints[n] += joint_gain * ((momentum.joint_momentum[n] - past_joints[n]) / dt - known - joints[n])
        past_joints[n] = momentum.joint_momentum[n]
    for i in range(3):
        force = -gains.weight if i == 2 else 0.0
        if start:
            base[i], base[3 + i] = -force, 0.0
        else:
            base[i] += push_gain * ((total[i] - past[i]) / dt - force - base[i])
            base[3 + i] += push_gain * ((spin[i] - past[3 + i]) / dt - base[3 + i])
        past[i], past[3 + i] = total[i], spin[i]
    sums = np.zeros(6)
    thrust, torque = np.empty(3), np.empty(3)
    for foot in range(2):
        _leg_wrench(joints, legs[foot], momentum, foot, gains.damping, gains.moment_arm, state.estimated[foot])
        for i in range(6):
            state.measured[foot, i] += (1.0 if start else joint_gain) * (measured[foot, i] - state.measured[foot, i])
        # Both kinds of wrench have passed the low-pass of the joints: the base rows must pass it, too.
        wrench = state.measured[foot] if fault[foot] == 0.0 else state.estimated[foot]
        rotate(momentum.sole_rotations[foot], wrench[0:3], thrust)
        rotate(momentum.sole_rotations[foot], wrench[3:6], torque)
        sole = momentum.sole_positions[foot]
        x, y, z = sole[0] - com[0], sole[1] - com[1], sole[2] - com[2]
        sums[3] += torque[0] + y * thrust[2] - z * thrust[1]
        sums[4] += torque[1] + z * thrust[0] - x * thrust[2]
        sums[5] += torque[2] + x * thrust[1] - y * thrust[0]
        for i in range(3):
            sums[i] += thrust[i]
    for i in range(6):
        state.feet[i] += (1.0 if start else push_gain) * (sums[i] - state.feet[i])
        state.lagged[i] += (1.0 if start else joint_gain) * (base[i] - state.lagged[i])
        state.push[i] = state.lagged[i] - state.feet[i]
    for i in range(3):
        state.centroid[0, i] = q[i] + com[i]
        state.centroid[1, i], state.centroid[2, i] = momentum.com_velocity[i], spin[i]
    state.ground[0] = q[2] + min(momentum.sole_positions[0, 2], momentum.sole_positions[1, 2])
    _detect_push(dt, doubtful, gains, state)
