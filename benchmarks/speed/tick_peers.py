"""Peers of the whole-body tick: placo's dynamics solver on the same task, and bare Pinocchio calls.

Shared by both problems: model with rotor inertia, state, references, desired accelerations, task weights (CoM, base and
torso orientation, swing foot, upper-body and leg posture), soles as hard constraints with the same feedback, contact
rectangles, friction pyramid, limits on torque, joint position and joint velocity. The differences that cost time are in
placo's favour. Its CoM task has one weight for all axes, and so has each half of its swing-foot task. It has no angular
momentum task, no yaw-moment rows (9 rows per foot, ours 17) and no upper bound on the normal force. Its wrenches are
regularised to zero, ours to the planned share of the weight. It reports no KKT residual, ours is checked on every tick.
Copying state and references into placo is not timed.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
import pinocchio as pin
import placo

from controllers.balance.controller import BalanceController
from controllers.whole_body.config import WholeBodyConfig
from models.constants import GRAVITY
from models.mujoco_model import build_mujoco, pin_to_mujoco
from models.robot_model import SOLE_FRAMES, RobotModel
from models.types import RobotState, Vector
from planners.whole_body_ik import bare_robot

#: Frames in placo's model at the centre of each contact rectangle, because placo centres contacts on their frame
CONTACT_FRAMES = ("tick/left", "tick/right")


class PlacoTick:
    """placo's ``DynamicsSolver`` on the task of the whole-body controller, with one or both feet on the floor."""

    def __init__(self, model: RobotModel, config: WholeBodyConfig) -> None:
        self._model = model
        self._robot = robot = _placo_robot(model)
        self._solver = solver = placo.DynamicsSolver(robot)
        solver.enable_torque_limits(True)
        solver.enable_joint_limits(True)
        solver.enable_velocity_limits(True)
        solver.dt = 1.0 / config.limits.velocity_gain
        solver.torque_cost = 0.0
        for name, inertia, torque in zip(model.joint_names, model.armature, model.tau_max, strict=True):
            robot.set_rotor_inertia(name, float(inertia))
            solver.set_torque_limit(name, float(config.limits.torque * torque))
        self._com = solver.add_com_task(np.zeros(3))
        self._com.kp = self._com.kd = 0.0
        self._com.configure("com", "soft", config.com.weight)
        self._base = self._orientation("base_link", config.base_orientation.kp, config.base_orientation.kd)
        self._base.configure("base", "soft", config.base_orientation.weight)
        self._torso = self._orientation("torso", config.torso_orientation.kp, config.torso_orientation.kd)
        self._torso.configure("torso", "soft", config.torso_orientation.weight)
        legs = {int(index) - 6 for foot in model.feet for index in foot.joint_ids_v}
        self._joint_tasks: list[placo.DynamicsJointsTask] = []
        for in_legs, scale in ((False, 1.0), (True, config.posture_leg_scale)):
            task = solver.add_joints_task()
            task.kp, task.kd = config.posture.kp, config.posture.kd
            task.configure(f"posture {in_legs}", "soft", config.posture.weight * scale)
            self._joint_tasks.append(task)
        self._joint_task = [self._joint_tasks[int(index in legs)] for index in range(model.nj)]
        self._centres: list[Vector] = []
        self._soles: list[placo.DynamicsFrameTask] = []
        self._contacts: list[placo.DynamicsContact] = []
        self._gains = config.contact, config.foot
        wrench_weight = config.contact.wrench_weight / (model.mass * GRAVITY) ** 2
        for foot, frame in zip(model.feet, CONTACT_FRAMES, strict=True):
            sole = solver.add_frame_task(frame, np.eye(4))
            contact = solver.add_planar_contact(sole)
            x_min, x_max, y_min, y_max = foot.rectangle
            margin = 2.0 * config.contact.sole_margin
            contact.length, contact.width = x_max - x_min - margin, y_max - y_min - margin
            contact.mu = min(config.contact.friction, foot.friction) / np.sqrt(2.0)
            contact.weight_forces = wrench_weight
            contact.weight_moments = wrench_weight / config.contact.moment_arm**2
            self._centres.append(_centre(foot.rectangle))
            self._soles.append(sole)
            self._contacts.append(contact)
            self._bear(len(self._soles) - 1, True)
        self.success = False  #: Whether the last solve found a solution
        self.acceleration = np.zeros(model.nv)  #: Generalised acceleration (nv,) [m/s^2, rad/s^2]
        self.torque = np.zeros(model.nj)  #: Joint torques (nj,) [N.m]

    def _orientation(self, frame: str, kp: float, kd: float) -> placo.DynamicsOrientationTask:
        name = self._model.pin.frames[self._model.frame_id(frame)].name
        task = self._solver.add_orientation_task(f"tick/{frame}" if name == frame else name, np.eye(3))
        task.kp, task.kd = kp, kd
        return task

    def _bear(self, foot: int, bears: bool) -> None:
        """Set a foot to stance (held in place) or swing (tracks its reference)."""
        standing, swinging = self._gains
        sole, self._contacts[foot].active = self._soles[foot], bears
        if bears:
            sole.configure(CONTACT_FRAMES[foot], "hard")
        else:
            sole.configure(CONTACT_FRAMES[foot], "soft", swinging.weight, swinging.weight)
        for part in (sole.position(), sole.orientation()):
            part.kp, part.kd = (standing.stiffness, standing.damping) if bears else (swinging.kp, swinging.kd)

    def prepare(self, state: RobotState, controller: BalanceController) -> None:
        """Copy the state and the latest references of the controller into placo; not timed."""
        reference = controller.reference
        self._robot.state.q, self._robot.state.qd = state.q, state.v
        desired = controller.whole_body.com_task.override
        self._com.ddtarget_world = np.zeros(3) if desired is None else desired
        self._base.R_world_frame = reference.base_orientation
        self._torso.R_world_frame = reference.torso_orientation
        for task, name, q, v, a in zip(
            self._joint_task,
            self._model.joint_names,
            reference.posture.tolist(),
            reference.posture_velocity.tolist(),
            reference.posture_acceleration.tolist(),
            strict=True,
        ):
            task.set_joint(name, q, v, a)
        for foot, sole in enumerate(self._soles):
            if reference.contacts[foot] != self._contacts[foot].active:
                self._bear(foot, reference.contacts[foot])
            rotation, position = reference.sole_rotations[foot], reference.sole_positions[foot]
            velocity, acceleration = reference.sole_velocities[foot], reference.sole_accelerations[foot]
            place, turn = sole.position(), sole.orientation()
            place.target_world = position + rotation @ self._centres[foot]
            place.dtarget_world, place.ddtarget_world = velocity[:3], acceleration[:3]
            turn.R_world_frame = rotation
            turn.omega_world, turn.domega_world = velocity[3:], acceleration[3:]

    def step(self) -> None:
        """Run one complete tick of placo: model terms, problem, solution, torques."""
        self._robot.update_kinematics()
        result = self._solver.solve()
        self.success = result.success
        self.acceleration = result.qdd
        self.torque = result.tau[6:]


class PinocchioCalls:
    """Pinocchio calls from Python for all terms of the problem; our tick needs fewer calls, and compiled kernels."""

    def __init__(self, model: RobotModel) -> None:
        self._pin, self._data = model.pin, model.data()
        self._frames = (*(foot.frame_id for foot in model.feet), model.frame_id("torso"))
        self._zero = np.zeros(model.nv)

    def step(self, q: Vector, v: Vector) -> None:
        """Evaluate all terms at one state (nq,), (nv,)."""
        model, data = self._pin, self._data
        pin.forwardKinematics(model, data, q, v, self._zero)
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        pin.crba(model, data, q)
        pin.nonLinearEffects(model, data, q, v)
        for frame in self._frames:
            pin.getFrameJacobian(model, data, frame, pin.LOCAL)
            pin.getFrameVelocity(model, data, frame, pin.LOCAL)
            pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL)
        pin.centerOfMass(model, data, q, v, self._zero)
        pin.jacobianCenterOfMass(model, data, q)
        pin.ccrba(model, data, q, v)


def _centre(rectangle: tuple[float, float, float, float]) -> Vector:
    """Return the centre of a contact rectangle in the sole frame (3,) [m]."""
    x_min, x_max, y_min, y_max = rectangle
    return np.array([0.5 * (x_min + x_max), 0.5 * (y_min + y_max), 0.0])


def _placo_robot(model: RobotModel) -> placo.RobotWrapper:
    frames = {f"tick/{name}": model.frame_on_link(name) for name in ("base_link", "torso")}
    for foot, sole, name in zip(model.feet, SOLE_FRAMES, CONTACT_FRAMES, strict=True):
        link, placement = model.frame_on_link(sole)
        frames[name] = link, placement * pin.SE3(np.eye(3), _centre(foot.rectangle))
    return bare_robot(model, frames)


#: Task weights, equal in both; they do not affect the time [-]
COSTS = {"sole": 10.0, "com": 5.0, "torso": 1.0, "posture": 1e-2}
SOLVER = "daqp"  # back-end of both: the fastest dense solver for this size
PERIOD = 0.001  # integration time of velocities [s]


class KinematicPeer(ABC):
    """One tick of inverse kinematics on soles, CoM, torso and posture; ``velocity`` is the latest solution (nv,)."""

    velocity: Vector
    _configuration: Any
    _q: Vector

    def _begin(self, model: RobotModel, q: Vector, tasks: list[Any], solve: Callable[[list[Any]], Vector]) -> None:
        for task in tasks:
            task.set_target_from_configuration(self._configuration)
        self._tasks, self._solve, self._q, self.velocity = tasks, solve, q, np.zeros(model.nv)

    @abstractmethod
    def prepare(self, state: RobotState) -> None:
        """Copy the state; not timed."""

    def step(self) -> None:
        """Run one complete tick: kinematics, problem, solution."""
        self._configuration.update(self._q)
        self.velocity = self._solve(self._tasks)


def installed_peers(model: RobotModel) -> dict[str, KinematicPeer]:
    """Return the peers that can be imported, by name."""
    kinds: dict[str, type[PinkTick] | type[MinkTick]] = {"pink": PinkTick, "mink": MinkTick}
    ready = find_spec("qpsolvers") is not None
    return {name: kind(model) for name, kind in kinds.items() if ready and find_spec(name) is not None}


class PinkTick(KinematicPeer):
    """pink's ``solve_ik``; ``velocity`` in Pinocchio's order [m/s, rad/s]."""

    def __init__(self, model: RobotModel) -> None:
        import pink
        from pink.tasks import ComTask, FrameTask, PostureTask

        q = model.standing_configuration()
        self._configuration = pink.Configuration(model.pin, model.data(), q)
        names = [model.pin.frames[foot.frame_id].name for foot in model.feet]
        torso = model.pin.frames[model.frame_id("torso")].name
        tasks = [
            *(FrameTask(name, COSTS["sole"], COSTS["sole"]) for name in names),
            ComTask(COSTS["com"]),
            FrameTask(torso, 0.0, COSTS["torso"]),
            PostureTask(COSTS["posture"]),
        ]
        self._begin(model, q, tasks, lambda tasks: pink.solve_ik(self._configuration, tasks, PERIOD, solver=SOLVER))

    def prepare(self, state: RobotState) -> None:
        self._q = state.q.copy()


class MinkTick(KinematicPeer):
    """mink's ``solve_ik``; ``velocity`` in MuJoCo's order [m/s, rad/s]."""

    def __init__(self, model: RobotModel) -> None:
        import mink

        self._model = model
        self._mujoco = mujoco = build_mujoco(model, timestep=PERIOD)
        q, _ = pin_to_mujoco(model, mujoco, model.standing_configuration(), np.zeros(model.nv))
        self._configuration = mink.Configuration(mujoco.model, q=q)
        names = [mujoco.model.site(site).name for site in mujoco.sole_sites]
        frame = mujoco.model.body(mujoco.bodies["torso"]).name
        tasks = [
            *(mink.FrameTask(name, "site", COSTS["sole"], COSTS["sole"]) for name in names),
            mink.ComTask(COSTS["com"]),
            mink.FrameTask(frame, "body", 0.0, COSTS["torso"]),
            mink.PostureTask(mujoco.model, COSTS["posture"]),
        ]
        limits = [mink.ConfigurationLimit(mujoco.model)]
        self._begin(
            model, q, tasks, lambda tasks: mink.solve_ik(self._configuration, tasks, PERIOD, SOLVER, limits=limits)
        )

    def prepare(self, state: RobotState) -> None:
        self._q, _ = pin_to_mujoco(self._model, self._mujoco, state.q, state.v)
