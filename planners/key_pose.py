"""Key poses: bounds of a motion, and the configuration that reaches a key pose or the reason of the failure."""

import math

import numpy as np
import pinocchio as pin

from models.errors import UnreachableError
from models.robot_model import RobotModel
from models.types import Vector
from planners.collision import SelfCollision
from planners.goals import FrameGoal, PoseGoal, Stance, tilt_of
from planners.motion_config import MotionConfig
from planners.whole_body_ik import Bounds, WholeBodyIk, chain

_TOUCH = 1e-3  #: Tolerance of body distances, and distance below which messages list a bound as active [m, rad]
_LISTED = 3  #: Largest number of body pairs in a message


class KeyPoseSolver:
    """Solves key poses; ``UnreachableError`` names the reason of a failure."""

    def __init__(self, model: RobotModel, config: MotionConfig, collision: SelfCollision, ik: WholeBodyIk) -> None:
        self._model = model
        self._config = config
        self._collision = collision
        self._ik = ik
        self._data = model.data()
        self._legs = sorted(i - 6 for foot in model.feet for i in foot.joint_ids_v)

    def clipped(self, joints: Vector) -> Vector:
        """Start posture clipped to the joint limits; ``UnreachableError`` beyond ``limits.start_overrun``."""
        inside = np.clip(joints, self._model.q_lower, self._model.q_upper)
        overrun = np.abs(joints - inside)
        worst = int(overrun.argmax())
        if overrun[worst] > self._config.limits.start_overrun:
            raise UnreachableError(
                f"start posture: joint '{self._model.joint_names[worst]}' at {joints[worst]:.4g} rad is outside "
                f"[{self._model.q_lower[worst]:.4g}, {self._model.q_upper[worst]:.4g}]"
            )
        return inside

    def unplanted(self, stance: Stance) -> str:
        """Reason why the soles are not on one plane; empty if they are."""
        balance = self._config.balance
        for sole, foot in zip(stance.soles, self._model.feet, strict=True):
            tilt, step = math.acos(min(float(sole.rotation[2, 2]), 1.0)), abs(float(sole.translation[2]))
            if tilt > balance.sole_tilt or step > balance.sole_step:
                return (
                    f"start posture: the {foot.name} sole is {tilt:.3f} rad and {step:.3f} m off the mean plane of "
                    f"both soles, at most {balance.sole_tilt:g} rad and {balance.sole_step:g} m; the motion 'stand' "
                    "brings it back: send 'stand' first"
                )
        return ""

    def gaps(self, q: Vector) -> Vector:
        """Least allowed distance of each pair of bodies in a motion from a start configuration (nq,) [m]."""
        collision = self._config.collision
        return np.minimum(collision.margin, self._collision.distances(q, collision.trigger))

    def bounds(self, stance: Stance, *safe: Vector) -> Bounds:
        """Bounds of a motion that starts on ``stance``, widened to include the ``safe`` joint positions (nj,) [rad].

        A margin that the start violates is reduced to the distance at the start. Raises ``UnreachableError`` if the
        soles are not on one plane, or the CoM is less than ``com_margin_start`` inside the support polygon.
        """
        balance, limits = self._config.balance, self._config.limits
        if reason := self.unplanted(stance):
            raise UnreachableError(reason)
        margin = stance.margin(stance.com)
        if margin < balance.com_margin_start:
            raise UnreachableError(
                f"start posture: the CoM is {margin:.3f} m inside the support polygon, at least "
                f"{balance.com_margin_start:g} m"
            )
        known = np.array([stance.q[7:], *safe])
        return Bounds(
            lower=np.minimum(self._model.q_lower + limits.joint_margin, known.min(axis=0)),
            upper=np.maximum(self._model.q_upper - limits.joint_margin, known.max(axis=0)),
            com_margin=min(balance.com_margin, margin),
            base_tilt=max(balance.base_tilt, tilt_of(stance.q)),
            gaps=self.gaps(stance.q),
        )

    def solve(self, goal: PoseGoal, seed: Vector, stance: Stance, bounds: Bounds) -> Vector:
        """Configuration (nq,) of a key pose, solved from ``seed`` (nq,); ``UnreachableError`` names the cause."""
        q = self._settle(goal, seed, bounds)
        missed = self._missed(goal, q)
        if missed:
            raise UnreachableError(f"{goal.name}: {', '.join(missed)}; {self._stops(goal, q, stance, bounds)}")
        touching = self._too_close(q, bounds)
        if touching.size:
            raise UnreachableError(f"{goal.name}: {self._pairs_text(touching, q)}")
        return q

    def _settle(self, goal: PoseGoal, seed: Vector, bounds: Bounds) -> Vector:
        """Solve; repeat with more pairs while bodies come too close, and with relaxed habits if a target is missed."""
        avoided: set[int] = set()
        habits = 1.0
        q = seed
        for _ in range(self._config.solver.rounds):
            found = self._ik.reach(goal, seed, sorted(avoided), habits)
            if found is None:
                raise UnreachableError(
                    f"{goal.name}: planted soles, joint limits, the CoM above the support polygon and the distances "
                    "between bodies contradict each other on the way to the target"
                )
            q = found
            fresh = {int(k) for k in self._too_close(q, bounds) if bounds.gaps[k] >= self._config.collision.margin}
            if fresh - avoided:
                avoided |= fresh | self._near(seed, bounds) | self._near(q, bounds)
            elif habits == 1.0 and self._missed(goal, q):
                habits = self._config.solver.relaxed_habits
            else:
                break
        return q

    def _near(self, q: Vector, bounds: Bounds) -> set[int]:
        """Pairs less than twice the trigger apart, without those that start inside the margin."""
        reach = 2.0 * self._config.collision.trigger
        near = (self._collision.distances(q, reach) < reach) & (bounds.gaps >= self._config.collision.margin)
        return {int(k) for k in np.flatnonzero(near)}

    def _too_close(self, q: Vector, bounds: Bounds) -> np.ndarray:
        """Pairs closer than ``bounds.gaps`` by more than ``_TOUCH`` (k,)."""
        return np.flatnonzero(self._collision.distances(q, self._config.collision.trigger) < bounds.gaps - _TOUCH)

    def _missed(self, goal: PoseGoal, q: Vector) -> list[str]:
        tolerances = self._config.solver
        pin.framesForwardKinematics(self._model.pin, self._data, q)
        missed: list[str] = []
        for frame in goal.frames:
            place = self._data.oMf[self._model.frame_id(frame.frame)]
            gap, turn = _errors(frame, place)
            if gap > tolerances.position_tolerance:
                missed.append(f"position of {frame.frame} missed by {gap:.3f} m")
            if turn > tolerances.orientation_tolerance:
                missed.append(f"orientation of {frame.frame} missed by {turn:.3f} rad")
        for i, value in goal.joints.items():
            if abs(q[7 + i] - value) > tolerances.joint_tolerance:
                missed.append(f"joint '{self._model.joint_names[i]}' missed by {abs(q[7 + i] - value):.3f} rad")
        return missed

    def _stops(self, goal: PoseGoal, q: Vector, stance: Stance, bounds: Bounds) -> str:
        """Active bounds that may prevent a configuration from reaching its targets."""
        reasons: list[str] = []
        moving = set(self._legs)
        for frame in goal.frames:
            moving |= chain(self._model, frame.frame)
        for i in sorted(moving | set(goal.joints)):
            name, value = self._model.joint_names[i], q[7 + i]
            if value < bounds.lower[i] + _TOUCH:
                reasons.append(f"joint '{name}' is at its lower limit {self._model.q_lower[i]:.3f} rad")
            elif value > bounds.upper[i] - _TOUCH:
                reasons.append(f"joint '{name}' is at its upper limit {self._model.q_upper[i]:.3f} rad")
        com = np.array(pin.centerOfMass(self._model.pin, self._data, q))
        if stance.margin(com) < bounds.com_margin + _TOUCH:
            reasons.append(f"the CoM is at the support polygon's margin of {bounds.com_margin:.3f} m")
        distances = self._collision.distances(q, self._config.collision.trigger)
        touching = np.flatnonzero(distances < self._config.collision.margin + _TOUCH)
        if touching.size:
            reasons.append(self._pairs_text(touching, q))
        return "stopped because " + "; ".join(reasons) if reasons else "the limbs are stretched or the targets conflict"

    def _pairs_text(self, pairs: np.ndarray, q: Vector) -> str:
        distances = self._collision.distances(q, self._config.collision.trigger)
        nearest = sorted((int(k) for k in pairs), key=lambda k: float(distances[k]))
        named = [f"'{' and '.join(self._collision.names(k))}' ({distances[k]:.3f} m apart)" for k in nearest[:_LISTED]]
        more = f" and {len(nearest) - _LISTED} more" if len(nearest) > _LISTED else ""
        return f"bodies would collide: {', '.join(named)}{more}"


def _errors(goal: FrameGoal, place: pin.SE3) -> tuple[float, float]:
    """Position [m] and orientation [rad] error of a frame; zero for a part that the goal leaves free."""
    gap = turn = 0.0
    if goal.position is not None:
        rows = ["xyz".index(axis) for axis in goal.axes]
        gap = float(np.linalg.norm((place.translation - goal.position)[rows]))
    if goal.rotation is not None:
        turn = float(np.linalg.norm(pin.log3(place.rotation.T @ goal.rotation)))
    return gap, turn
