"""Tasks of the whole-body QP, each a class with its compiled code."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.qp.terms import BASE, TORSO, Centroid, Dynamics, FrameTerms, ModelTerms, Terms, frame_of, pose_error
from models.numerics.compiled import njit
from models.numerics.so3 import rotation_error
from models.types import Matrix, Reference, Vector

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


class TaskArrays(NamedTuple):
    """Arrays of a task for compiled code; see ``Task`` and ``GainTask``."""

    active: Flags
    weight: Array
    weight_in_force: Array
    kp: Array
    kd: Array
    error: Array
    jacobian: Array
    target: Array


class Task(ABC):
    r"""An acceleration-level objective: a weighted least-squares term of the QP.

    .. math:: \min_a \tfrac12 \|J a - b\|_W^2, \qquad b = a_{ff} + k_p\,\mathrm{error} + k_d\,\mathrm{error\ rate} -
        \dot J v

    A subclass implements ``update`` and has a unique ``name``. Pass an instance to
    ``WholeBodyController(extra_tasks=...)``. ``weight`` has one entry per row (k,); zero disables a row. ``frames`` are
    the names of the frames that the task reads from ``Terms.frames``.
    """

    def __init__(self, name: str, weight: Vector, nv: int, frames: tuple[str, ...] = ()) -> None:
        self.name, self.weight, self.frames = name, weight, frames
        rows = len(weight)
        self._active: Flags = np.array([weight.any()])
        #: Desired minus measured; b, desired acceleration minus drift; W of the last tick, zero while inactive
        self.error, self.target, self.weight_in_force = np.zeros(rows), np.zeros(rows), np.zeros(rows)
        self.jacobian: Matrix = np.zeros((rows, nv))

    @property
    def active(self) -> bool:
        """Whether the task is part of the QP."""
        return bool(self._active[0])

    @active.setter
    def active(self, value: bool) -> None:
        self._active[0] = value

    @abstractmethod
    def update(self, terms: Terms, reference: Reference) -> None:
        """Compute ``error``, ``jacobian`` and ``target`` in place from the model terms and the reference."""

    def write_into(self, jacobian: Matrix, target: Vector, weight: Vector) -> None:
        """Replace ``jacobian``, ``target`` and ``weight_in_force`` by views of larger arrays."""
        jacobian[:], target[:] = self.jacobian, self.target
        self.jacobian, self.target, self.weight_in_force = jacobian, target, weight


class GainTask(Task):
    """A task with feedback gains ``kp`` and ``kd`` per row (k,) [1/s^2, 1/s]."""

    def __init__(
        self, name: str, kp: Vector, kd: Vector, weight: Vector, nv: int, frames: tuple[str, ...] = ()
    ) -> None:
        super().__init__(name, weight, nv, frames)
        self.kp, self.kd = kp, kd

    @property
    def arrays(self) -> TaskArrays:
        """Record for compiled code."""
        return TaskArrays(
            self._active,
            self.weight,
            self.weight_in_force,
            self.kp,
            self.kd,
            self.error,
            self.jacobian,
            self.target,
        )


class CoMTask(GainTask):
    r"""Accelerate the centre of mass, in W.

    .. math:: \ddot c^* = \ddot c_{ref} + k_p (c_{ref} - c) + k_d (\dot c_{ref} - \dot c)

    ``override`` replaces the desired acceleration by that of a balance law (3,) [m/s^2]; disabled when None.
    """

    def __init__(self, kp: Vector, kd: Vector, weight: Vector, nv: int) -> None:
        super().__init__("com", kp, kd, weight, nv)
        self.override: Vector | None = None

    def desired(self, terms: Terms, reference: Reference) -> Vector:
        """Desired acceleration in W (3,) [m/s^2]."""
        if self.override is not None:
            return self.override
        error, rate = reference.com - terms.com, reference.com_velocity - terms.com_velocity
        acceleration: Vector = reference.com_acceleration + self.kp * error + self.kd * rate
        return acceleration

    def update(self, terms: Terms, reference: Reference) -> None:
        """CoM Jacobian in W; error in W [m]."""
        _com_rows(self.arrays, terms.centroid, reference.com, self.desired(terms, reference))


@njit(cache=True, forceinline=True)
def _com_rows(task: TaskArrays, terms: Centroid, com: Array, acceleration: Array) -> None:
    task.jacobian[:] = terms.com_jacobian
    for i in range(3):
        task.error[i] = com[i] - terms.com[i]
        task.target[i] = acceleration[i] - terms.com_drift[i]


class AngularMomentumTask(GainTask):
    r"""Damp the angular momentum about the CoM, in W.

    .. math:: \dot L^* = -k_d L, \qquad \dot L = A_G a + \dot A_G v

    References:
        Orin, Goswami, Lee: Centroidal dynamics of a humanoid robot (2013), eq. 14.
    """

    def __init__(self, kd: Vector, weight: Vector, nv: int) -> None:
        super().__init__("angular_momentum", np.zeros(3), kd, weight, nv)

    def update(self, terms: Terms, reference: Reference) -> None:
        """Angular rows of the centroidal map in W; error [kg.m^2/s]."""
        _momentum_rows(self.arrays, terms.centroid)


@njit(cache=True, forceinline=True)
def _momentum_rows(task: TaskArrays, terms: Centroid) -> None:
    task.jacobian[:] = terms.momentum_matrix
    for i in range(3):
        task.error[i] = -terms.momentum[i]
        task.target[i] = task.kd[i] * task.error[i] - terms.momentum_drift[i]


class PostureTask(GainTask):
    r"""Track the reference of every joint.

    .. math:: \ddot q^* = \ddot q_{ref} + k_p (q_{ref} - q) + k_d (\dot q_{ref} - \dot q)

    The QP does not stack the Jacobian, since it is the identity on the joints.
    """

    def __init__(self, kp: Vector, kd: Vector, weight: Vector) -> None:
        nj = len(weight)
        super().__init__("posture", kp, kd, weight, 6 + nj)
        self.jacobian[:, 6:] = np.eye(nj)

    def update(self, terms: Terms, reference: Reference) -> None:
        """Joint error [rad]."""
        rate, acceleration = reference.posture_velocity, reference.posture_acceleration
        _posture_rows(self.arrays, terms.dynamics, reference.posture, rate, acceleration)


@njit(cache=True, forceinline=True)
def _posture_rows(task: TaskArrays, terms: Dynamics, desired: Array, rate: Array, feedforward: Array) -> None:
    for j in range(task.target.shape[0]):
        task.error[j] = desired[j] - terms.q[7 + j]
        step = rate[j] - terms.v[6 + j]
        task.target[j] = feedforward[j] + task.kp[j] * task.error[j] + task.kd[j] * step


class FramePositionTask(GainTask):
    r"""Hold the origin of a frame F at a point; rows in the axes of F.

    .. math:: \dot v^* = k_p R^T (p_{ref} - p) - k_d v
    """

    def __init__(self, name: str, frame: str, kp: Vector, kd: Vector, weight: Vector, nv: int) -> None:
        super().__init__(name, kp, kd, weight, nv, (frame,))
        self.frame, self.active = frame, False
        self._desired: Vector | None = None

    @property
    def desired(self) -> Vector | None:
        """p_ref in W (3,) [m]; None switches the task off."""
        return self._desired

    @desired.setter
    def desired(self, point: Vector | None) -> None:
        self._desired = None if point is None else np.array(point, dtype=float)
        self.active = point is not None and bool(self.weight.any())

    def update(self, terms: Terms, reference: Reference) -> None:
        """Linear rows of the Jacobian; error in F [m]."""
        if self._desired is not None:
            _position_rows(self.arrays, terms.frames[self.frame], self._desired)


@njit(cache=True)
def _position_rows(task: TaskArrays, frame: FrameTerms, desired: Array) -> None:
    for i in range(3):
        error = 0.0
        for k in range(3):
            error += frame.pose[k, i] * (desired[k] - frame.pose[k, 3])
        task.error[i] = error
        task.target[i] = task.kp[i] * error - task.kd[i] * frame.twist[i] - frame.drift[i]
        task.jacobian[i] = frame.jacobian[i]


class FrameOrientationTask(GainTask):
    r"""Turn a frame F to a desired orientation; rows in the axes of F.

    .. math:: \dot\omega^* = k_p \log(R^T R_{ref}) + k_d (R^T \omega_{ref} - \omega)

    where the desired angular velocity is the heading rate of the reference about the vertical. ``desired`` returns
    R_ref of a reference.
    """

    def __init__(
        self,
        name: str,
        frame: str,
        kp: Vector,
        kd: Vector,
        weight: Vector,
        nv: int,
        desired: Callable[[Reference], Matrix],
    ) -> None:
        super().__init__(name, kp, kd, weight, nv, (frame,))
        self.frame, self.desired = frame, desired

    def update(self, terms: Terms, reference: Reference) -> None:
        """Angular rows of the Jacobian; the error is a rotation vector in F [rad]."""
        frame, desired = terms.frames[self.frame], self.desired(reference)
        _orientation_rows(self.arrays, frame, desired, reference.heading_rate)


@njit(cache=True, forceinline=True)
def _orientation_rows(task: TaskArrays, frame: FrameTerms, desired: Array, heading_rate: float) -> None:
    rotation_error(frame.pose, desired, task.error)
    for i in range(3):
        rate = heading_rate * frame.pose[2, i] - frame.twist[3 + i]
        task.target[i] = task.kp[i] * task.error[i] + task.kd[i] * rate - frame.drift[3 + i]
        task.jacobian[i] = frame.jacobian[3 + i]


class FootTask(GainTask):
    r"""Track the reference of a swing foot; all quantities in the sole frame.

    .. math::
        a^* = R^T a_{ref} + k_p \begin{bmatrix} R^T (p_{ref} - p) \\ \log(R^T R_{ref}) \end{bmatrix}
        + k_d (R^T v_{ref} - v)

    While the foot is planned to bear load, the contact rows hold it, and the task acts only about the free axes.
    """

    def __init__(self, foot: int, kp: Vector, kd: Vector, weight: Vector, nv: int) -> None:
        super().__init__(("left_foot", "right_foot")[foot], kp, kd, weight.copy(), nv)
        self.foot, self._full = foot, weight

    def release(self, free: Flags | None) -> None:
        """Restrict the task to the free axes of x and y (2,) of a stance foot; all rows when None, for a swing foot."""
        self.weight[:] = self._full
        if free is not None:
            self.weight[:3] = self.weight[5] = 0.0
            self.weight[3:5] *= free
        self.active = bool(self.weight.any())

    def update(self, terms: Terms, reference: Reference) -> None:
        """Jacobian of the sole; the error is position and rotation vector in the sole frame [m, rad]."""
        foot = self.foot
        _foot_rows(
            self.arrays,
            terms.soles[foot],
            reference.sole_rotations[foot],
            reference.sole_positions[foot],
            reference.sole_velocities[foot],
            reference.sole_accelerations[foot],
        )


@njit(cache=True, forceinline=True)
def _foot_rows(
    task: TaskArrays, frame: FrameTerms, rotation: Array, position: Array, velocity: Array, acceleration: Array
) -> None:
    pose_error(frame.pose, rotation, position, task.error)
    for row in range(6):
        part, axis = 3 * (row // 3), row % 3
        v, a = 0.0, 0.0
        for k in range(3):
            v += frame.pose[k, axis] * velocity[part + k]
            a += frame.pose[k, axis] * acceleration[part + k]
        feedback = task.kp[row] * task.error[row]
        task.target[row] = a + feedback + task.kd[row] * (v - frame.twist[row]) - frame.drift[row]
        task.jacobian[row] = frame.jacobian[row]


class BodyArrays(NamedTuple):
    """Arrays of ``BodyTasks`` for compiled code."""

    com: TaskArrays
    momentum: TaskArrays
    base: TaskArrays
    torso: TaskArrays
    feet: tuple[TaskArrays, TaskArrays]
    posture: TaskArrays


class Desired(NamedTuple):
    """References of ``BodyTasks`` in one tick; see ``Reference`` for shapes and units."""

    com: Array
    com_acceleration: Array
    base_orientation: Array
    torso_orientation: Array
    heading_rate: float
    sole_rotations: Array
    sole_positions: Array
    sole_velocities: Array
    sole_accelerations: Array
    posture: Array
    posture_velocity: Array
    posture_acceleration: Array


class BodyTasks:
    """Tasks of every robot; ``base`` and ``torso`` use these frames. One compiled call updates all of them."""

    def __init__(
        self,
        com: CoMTask,
        momentum: AngularMomentumTask,
        base: FrameOrientationTask,
        torso: FrameOrientationTask,
        feet: Sequence[FootTask],
        posture: PostureTask,
    ) -> None:
        self.com, self.momentum, self.base, self.torso, self.posture = com, momentum, base, torso, posture
        self.left_foot, self.right_foot = feet

    @property
    def feet(self) -> tuple[FootTask, FootTask]:
        """Tasks of the left and the right foot."""
        return self.left_foot, self.right_foot

    def __iter__(self) -> Iterator[GainTask]:
        return iter((self.com, self.momentum, self.base, self.torso, *self.feet, self.posture))

    @property
    def arrays(self) -> BodyArrays:
        """Record for compiled code."""
        com, momentum, base, torso, left, right, posture = (task.arrays for task in self)
        return BodyArrays(com, momentum, base, torso, (left, right), posture)


@njit(cache=True, forceinline=True)
def body_rows(tasks: BodyArrays, terms: ModelTerms, desired: Desired) -> None:
    """Compute rows and weights in force of the active tasks; inactive tasks get zero weights, and their rows stay."""
    dynamics, centroid = terms.dynamics, terms.centroid
    if _weigh(tasks.com):
        _com_rows(tasks.com, centroid, desired.com, desired.com_acceleration)
    if _weigh(tasks.momentum):
        _momentum_rows(tasks.momentum, centroid)
    rate = desired.heading_rate
    if _weigh(tasks.base):
        _orientation_rows(tasks.base, frame_of(dynamics, BASE), desired.base_orientation, rate)
    if _weigh(tasks.torso):
        _orientation_rows(tasks.torso, frame_of(dynamics, TORSO), desired.torso_orientation, rate)
    for foot in range(2):
        if _weigh(tasks.feet[foot]):
            _foot_rows(
                tasks.feet[foot],
                frame_of(dynamics, foot),
                desired.sole_rotations[foot],
                desired.sole_positions[foot],
                desired.sole_velocities[foot],
                desired.sole_accelerations[foot],
            )
    if _weigh(tasks.posture):
        rates, accelerations = desired.posture_velocity, desired.posture_acceleration
        _posture_rows(tasks.posture, dynamics, desired.posture, rates, accelerations)


@njit(cache=True, forceinline=True)
def _weigh(task: TaskArrays) -> bool:
    """Set the weights in force; returns whether the task is active."""
    active = task.active[0]
    for i in range(task.weight.shape[0]):
        task.weight_in_force[i] = task.weight[i] if active else 0.0
    return bool(active)
