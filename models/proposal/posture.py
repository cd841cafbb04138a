"""Standing posture: knees slightly bent, soles flat and level, CoM above their middle, hands beside the body.

The leg joints x solve, by bounded least squares with the base upright at the origin,

    log(R_i(x)) = 0     y_i(x) = +-w / 2     z_l(x) = z_r(x)     x_c(x) - x_i(x) - m = 0     k_i(x) = k_0 + b

for both soles i, with rotation R_i, position (x_i, y_i, z_i), lateral distance w of the soles, middle m of the range of
x where the ankle can hold the CoP, x_c of the CoM, knee angle k_i, angle k_0 of the stretched leg, and bend b. The arms
solve for a position of the wrist below and ahead of the shoulder, with a small weight towards zero.

If standing on one leg takes more than ``torque_share`` of a knee's torque limit, the bend b is reduced, down to
``knee_least``.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

from models.constants import GRAVITY
from models.foot import WIDTH, ankle_joints
from models.proposal.config import PostureConfig
from models.proposal.shapes import Finding, named
from models.proposal.skeleton import BASE, Legs, Skeleton
from models.proposal.soles import SoleShape
from models.types import Vector

_BISECTIONS = 5  #: Bisection steps for the bend of weak knees [1]


def knee_shares(skeleton: Skeleton, legs: tuple[tuple[int, ...], ...], knees: list[int], q: Vector) -> list[float]:
    """Share of each knee's torque limit required to stand on that leg alone, in the configuration q (nq,) [-].

    tau = g(q) - J^T f, with the weight f = m g at a point of the foot below the CoM in the sagittal plane. The lateral
    position of the point does not affect the knee.
    """
    model = skeleton.model
    data = model.createData()
    gravity = pin.computeGeneralizedGravity(model, data, q)
    pin.computeJointJacobians(model, data, q)
    com = pin.centerOfMass(model, data, q)
    weight = GRAVITY * float(pin.computeTotalMass(model))
    shares = []
    for leg, knee in zip(legs, knees, strict=True):
        jacobian = pin.getJointJacobian(model, data, leg[-1], pin.LOCAL_WORLD_ALIGNED)
        arm = np.array([com[0] - data.oMi[leg[-1]].translation[0], 0.0, 0.0])
        wrench = np.concatenate([[0.0, 0.0, weight], np.cross(arm, [0.0, 0.0, weight])])
        v = int(model.joints[knee].idx_v)
        shares.append(abs(float(gravity[v] - jacobian[:, v] @ wrench)) / float(model.effortLimit[v]))
    return shares


Knee = tuple[int, float, float]  #: Joint, its angle with the leg stretched, and its bend relative to that angle [rad]

_HABIT = 1e-3  #: Weight of staying near the initial posture, relative to the tasks [-]
_SMALL = 5e-4  #: Joints closer to zero are omitted from the posture [rad]


@dataclass(frozen=True, slots=True)
class Standing:
    """Solution of ``PostureSolver``."""

    joints: dict[str, float]  # positions of the joints that are not at zero [rad]
    com_height: float  # above the soles [m]
    findings: tuple[Finding, ...]
    unmet: Finding | None  # why the robot cannot stand in this posture; None if it can


class PostureSolver:
    """Computes the standing posture of one robot."""

    def __init__(
        self, skeleton: Skeleton, legs: Legs, soles: tuple[SoleShape, SoleShape], config: PostureConfig
    ) -> None:
        self._skeleton, self._legs, self._soles, self._config = skeleton, legs, soles, config
        model = self._model = skeleton.model
        self._data = model.createData()
        self._lower, self._upper = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
        margin = config.margin * (self._upper[7:] - self._lower[7:])  # the free flyer has no limits
        self._lower[7:] += margin
        self._upper[7:] -= margin
        self._q = pin.neutral(model)
        self._q[7:] = np.clip(0.0, self._lower[7:], self._upper[7:])

    def solve(self, arms: tuple[tuple[int, ...], tuple[int, ...]]) -> Standing:
        """Place the hands, then the legs under the resulting CoM; ``arms`` are the joints of both arms, or empty."""
        findings: list[Finding] = []
        for side, arm in zip((1.0, -1.0), arms, strict=True):
            if arm:
                self._place_hand(arm, side)
        knees = [self._knee(leg) for leg in self._legs.both]
        for knee, stretched, bend in knees:
            if abs(bend) < 0.5 * self._config.knee:
                text = f"the knee bends only by {abs(bend):.2f} rad from the stretched leg ({stretched:.2f} rad)"
                findings.append(
                    Finding("wrong", named("joint", [self._skeleton.name(knee)]), text, "bent by this angle")
                )
        residuals, unmet = self._place_legs(knees, 1.0), None
        if (taken := self._taken(knees)) > self._config.torque_share:
            residuals = self._straighten(knees)
            names = [self._skeleton.name(knee) for knee, _, _ in knees]
            limit = float(self._model.effortLimit[self._model.joints[knees[0][0]].idx_v])
            left, share = self._taken(knees), abs(self._q[self._index((knees[0][0],))[0]] - knees[0][1])
            text = (
                f"little torque: bent by {self._config.knee:g} rad, one leg takes {taken * limit:.0f} of {limit:g} N.m"
            )
            remedy = f"bent only by {share:.2f} rad, which takes {left * limit:.0f} N.m"
            findings.append(Finding("note", named("joint", names), text, remedy))
        if np.abs(residuals[:6]).max() > self._config.level:
            stuck, needs = self._stuck(), self._needs([knee for knee, _, _ in knees])
            text = f"the soles cannot be level: {np.abs(residuals[:6]).max():.3f} rad off{needs}"
            unmet = Finding("wrong", stuck, text, "the nearest posture is proposed")
        elif np.abs(residuals[6:11]).max() > self._config.residual:
            text = f"the soles cannot be below the CoM: {1e3 * np.abs(residuals[6:11]).max():.0f} mm off"
            unmet = Finding("wrong", self._stuck(), text, "the nearest posture is proposed")
        findings += [] if unmet is None else [unmet]
        self._forward()
        com = pin.centerOfMass(self._model, self._data, self._q)
        height = float(com[2] - np.mean([place.translation[2] for place in self._sole_places()]))
        joints = {}
        for j in range(BASE + 1, self._model.njoints):
            value = float(self._q[self._model.joints[j].idx_q])
            if abs(value) > _SMALL:
                joints[self._skeleton.name(j)] = round(value, 4)
        return Standing(joints, height, tuple(findings), unmet)

    def _taken(self, knees: list[Knee]) -> float:
        """Maximum share of a knee's torque limit required to stand on one leg [-]."""
        return max(knee_shares(self._skeleton, self._legs.both, [knee for knee, _, _ in knees], self._q))

    def _straighten(self, knees: list[Knee]) -> Vector:
        """Bend the knees as far as their torque allows; returns the residuals."""
        low, high = self._config.knee_least / self._config.knee, 1.0
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            self._place_legs(knees, middle)
            low, high = (low, middle) if self._taken(knees) > self._config.torque_share else (middle, high)
        return self._place_legs(knees, low)

    def _place_legs(self, knees: list[Knee], share: float) -> Vector:
        """Bend the knees by a share of their bends, soles level below the CoM; returns the residuals."""
        targets = [stretched + share * bend for _, stretched, bend in knees]
        for (knee, _, _), leg, target in zip(knees, self._legs.both, targets, strict=True):
            self._bend(leg, knee, target)
        return self._place_feet([knee for knee, _, _ in knees], targets)

    def _forward(self) -> None:
        pin.forwardKinematics(self._model, self._data, self._q)

    def _index(self, joints: tuple[int, ...]) -> list[int]:
        return [int(self._model.joints[j].idx_q) for j in joints]

    def _sole_places(self) -> list[pin.SE3]:
        """Pose of both sole frames; needs forward kinematics."""
        places = []
        for leg, sole in zip(self._legs.both, self._soles, strict=True):
            link = self._model.frames[self._model.getFrameId(sole.link, pin.FrameType.BODY)]
            places.append(self._data.oMi[leg[-1]] * link.placement * sole.placement)
        return places

    def _knee(self, leg: tuple[int, ...]) -> Knee:
        """Find the knee, the joint that changes the length of the leg most, its stretched angle and its bend [rad]."""
        best = (0.0, leg[0], 0.0, 0.0)
        for joint in leg[1:-1]:
            i = int(self._model.joints[joint].idx_q)
            angles = np.linspace(self._lower[i], self._upper[i], 200)
            lengths = np.array([self._leg_length(leg, i, float(angle)) for angle in angles])
            stretched = float(angles[int(lengths.argmax())])
            swing = float(lengths.max() - lengths.min())
            if swing > best[0]:
                room = self._upper[i] - stretched, stretched - self._lower[i]
                bend = min(self._config.knee, room[0]) if room[0] >= room[1] else -min(self._config.knee, room[1])
                best = (swing, joint, stretched, float(bend))
        return best[1:]

    def _leg_length(self, leg: tuple[int, ...], index: int, angle: float) -> float:
        q = self._q.copy()
        q[index] = angle
        pin.forwardKinematics(self._model, self._data, q)
        return float(np.linalg.norm(self._data.oMi[leg[-1]].translation - self._data.oMi[leg[0]].translation))

    def _bend(self, leg: tuple[int, ...], knee: int, angle: float) -> None:
        """Initial guess: bend the knee and compensate half of its angle in each other pitch joint of the leg."""
        axes = self._skeleton.axes
        pitch = [j for j in leg if abs(float(axes[j] @ axes[knee])) > 0.9 and j != knee]
        self._q[self._index((knee,))] = angle
        for j in pitch:
            i = int(self._model.joints[j].idx_q)
            share = -0.5 * angle * np.sign(axes[j] @ axes[knee])
            self._q[i] = np.clip(share, self._lower[i], self._upper[i])

    def _place_feet(self, knees: list[int], targets: list[float]) -> Vector:
        """Solve for the legs; returns the residuals, rotations first."""
        indices = self._index((*self._legs.left, *self._legs.right))
        half = [self._middle(leg, sole) for leg, sole in zip(self._legs.both, self._soles, strict=True)]
        ankles = self._skeleton.origins[[leg[-1] for leg in self._legs.both], 1]
        inner = min(self._soles[0].rectangle[2], -self._soles[1].rectangle[3])
        side = max(0.5 * float(np.ptp(ankles)), 0.5 * self._config.gap - inner)

        def errors(x: Vector) -> Vector:
            self._q[indices] = x
            self._forward()
            places = self._sole_places()
            com = pin.centerOfMass(self._model, self._data, self._q)
            rows = [*pin.log3(places[0].rotation), *pin.log3(places[1].rotation)]
            rows += [place.translation[1] - y for place, y in zip(places, (side, -side), strict=True)]
            rows += [com[0] - place.translation[0] - m for place, m in zip(places, half, strict=True)]
            rows += [places[0].translation[2] - places[1].translation[2]]
            rows += [self._q[i] - t for i, t in zip(self._index(tuple(knees)), targets, strict=True)]
            return np.array(rows)

        start = np.clip(self._q[indices], self._lower[indices], self._upper[indices])
        span = 1e-9 * np.ones(len(indices))
        result = least_squares(
            lambda x: np.concatenate([errors(x), _HABIT * (x - start)]),
            start,
            bounds=(self._lower[indices] - span, self._upper[indices] + span),
            xtol=1e-12,
            ftol=1e-12,
        )
        # Solve again without regularisation, from the previous solution, so that the soles are exactly flat.
        final = least_squares(errors, result.x, bounds=(self._lower[indices] - span, self._upper[indices] + span))
        return np.asarray(errors(final.x))

    def _middle(self, leg: tuple[int, ...], sole: SoleShape) -> float:
        """Middle of the range of x, from the ankle, where the ankle can hold the CoP with half the weight [m]."""
        skeleton, model, joints = self._skeleton, self._model, list(leg)
        floor = (skeleton.place(sole.link) * sole.placement).translation[2]
        heights = skeleton.origins[joints, 2] - floor
        turns = np.vstack((np.zeros((3, len(leg))), skeleton.axes[joints].T))  # of the sole, in the base at zero
        ankle = [each for each in ankle_joints(turns, leg, heights.tolist(), float(heights[0])) if each.axis == WIDTH]
        torques = [float(model.effortLimit[model.joints[each.index_v].idx_v]) for each in ankle]
        reach = min(torques, default=np.inf) / (0.5 * GRAVITY * pin.computeTotalMass(model))
        return 0.5 * float(max(sole.rectangle[0], -reach) + min(sole.rectangle[1], reach))

    def _place_hand(self, arm: tuple[int, ...], side: float) -> None:
        indices = self._index(arm)
        self._forward()
        if not (length := self._skeleton.reach(list(arm))):  # a shoulder alone cannot place a hand
            return
        ahead, outward, up = self._config.hands[0]
        target = self._data.oMi[arm[0]].translation + length * np.array([ahead, side * outward, up])
        start = self._q[indices].copy()

        def errors(x: Vector) -> Vector:
            self._q[indices] = x
            self._forward()
            miss = (self._data.oMi[arm[-1]].translation - target) / length
            return np.concatenate([miss, np.sqrt(_HABIT) * (x - start)])

        inside = 0.5 * (self._lower[indices] + self._upper[indices])
        guess = start + 0.1 * (inside - start)  # away from the limits and from a stretched elbow
        result = least_squares(errors, guess, bounds=(self._lower[indices] - 1e-9, self._upper[indices] + 1e-9))
        self._q[indices] = np.clip(result.x, self._lower[indices], self._upper[indices])

    def _at_limits(self) -> list[int]:
        """Joints of the legs at their limits."""
        joints = (*self._legs.left, *self._legs.right)
        at = self._index(joints)
        room = np.minimum(self._q[at] - self._lower[at], self._upper[at] - self._q[at])
        return [joint for joint, left in zip(joints, room, strict=True) if left < 1e-3]

    def _needs(self, knees: list[int]) -> str:
        """Angles that the joints at their limits need for level soles at the same knee bend; empty without solution."""
        stuck, q, limits = self._at_limits(), self._q.copy(), (self._lower.copy(), self._upper.copy())
        at = self._index(tuple(stuck))
        self._lower[at], self._upper[at] = -np.pi, np.pi
        level = np.abs(self._place_feet(knees, q[self._index(tuple(knees))].tolist())).max() < self._config.level
        beyond = [
            f"joint '{self._skeleton.name(joint)}' at {self._q[i]:.2f} of [{low:.2f}, {high:.2f}] rad"
            for joint, i in zip(stuck, at, strict=True)
            for low, high in [(self._model.lowerPositionLimit[i], self._model.upperPositionLimit[i])]
            if not low <= self._q[i] <= high
        ]
        self._q[:], self._lower[:], self._upper[:] = q, *limits
        return f"; level soles below the CoM need {', '.join(beyond)}" if level and beyond else ""

    def _stuck(self) -> str:
        stuck = [self._skeleton.name(joint) for joint in self._at_limits()]
        ends = [self._skeleton.name(leg[-1]) for leg in self._legs.both]
        return named("joint", stuck or ends) + (" at the limit" if stuck else "")
