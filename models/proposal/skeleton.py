"""Analysis of the joints in the zero posture: mirrored partners, legs, arms, torso, head and IMU."""

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from models.constants import FOOT_NAMES
from models.errors import RobotModelError
from models.foot import leg_freedoms
from models.profile import Frame
from models.proposal.shapes import Finding, found, link_points, links_by_name, named
from models.types import Matrix, Vector

BASE = 1  #: Pinocchio's index of the free flyer; the joints of the URDF follow
_MIRROR = np.array([1.0, -1.0, 1.0])  # reflection in the plane y = 0 of the base
_PARALLEL = 0.99  # minimum cosine between an axis and the mirror image of its partner's


class Skeleton:
    """Joints at zero, base upright at the origin; arrays are indexed by Pinocchio's joint index.

    Reflection in the plane y = 0 maps a rotation by a about axis u to one by -a about M u, M = diag(1, -1, 1).
    Partners satisfy p' = M p (within ``tolerance`` [m]) and u' = -s M u; mirrored motions satisfy q' = s q.
    """

    def __init__(self, model: pin.Model, tolerance: float) -> None:
        self.model, self.data = model, model.createData()
        q = pin.neutral(model)
        pin.computeJointJacobians(model, self.data, q)
        pin.framesForwardKinematics(model, self.data, q)
        #: Origin of each joint in the base frame (njoints, 3) [m]
        self.origins: Matrix = np.array([place.translation for place in self.data.oMi])
        self.axes: Matrix = np.zeros_like(self.origins)  #: Axis of each joint in the base frame (njoints, 3)
        self.children: dict[int, list[int]] = {j: [] for j in range(model.njoints)}  #: Child joints of each joint
        for j in range(BASE + 1, model.njoints):
            jacobian = pin.getJointJacobian(model, self.data, j, pin.LOCAL_WORLD_ALIGNED)
            self.axes[j] = jacobian[3:, model.joints[j].idx_v]
            self.children[int(model.parents[j])].append(j)
        #: Mirror partner of each joint; the joint itself on the plane y = 0; joints without partner are absent
        self.partners: dict[int, int] = {BASE: BASE}
        self.signs: dict[int, float] = {}  #: s of each joint in ``partners``
        self._pair(BASE, BASE, tolerance)

    def _pair(self, first: int, second: int, tolerance: float) -> None:
        for joint in self.children[first]:
            image = _MIRROR * self.origins[joint]
            near = [k for k in self.children[second] if np.linalg.norm(self.origins[k] - image) < tolerance]
            near = [k for k in near if abs(self._agreement(joint, k)) > _PARALLEL]
            if not near:
                continue
            other = min(near, key=lambda k: (round(float(np.linalg.norm(self.origins[k] - image)), 4), k != joint))
            self.partners[joint] = other
            self.signs[joint] = float(np.sign(self._agreement(joint, other)))
            self._pair(joint, other, tolerance)

    def _agreement(self, joint: int, other: int) -> float:
        return float(-(_MIRROR * self.axes[joint]) @ self.axes[other])

    def name(self, joint: int) -> str:
        """Name of a joint in the URDF."""
        return str(self.model.names[joint])

    def chain(self, joint: int) -> list[int]:
        """Joints from the base (excluded) to ``joint`` (included)."""
        return [int(j) for j in self.model.supports[joint] if j > BASE]

    def below(self, joint: int) -> list[int]:
        """A joint and all its descendants."""
        return [joint, *(k for child in self.children[joint] for k in self.below(child))]

    def central(self, joint: int) -> bool:
        """Whether a joint is its own mirror image."""
        return self.partners.get(joint) == joint

    def links(self, joint: int) -> list[str]:
        """Links of the rigid body that a joint moves, nearest first."""
        return [
            str(frame.name)
            for frame in self.model.frames
            if frame.parentJoint == joint and frame.type == pin.FrameType.BODY
        ]

    def place(self, link: str) -> pin.SE3:
        """Pose of a link in the base frame."""
        return self.data.oMf[self.model.getFrameId(link, pin.FrameType.BODY)]

    def points(self, link: ET.Element) -> Matrix:
        """Points (n, 3) [m] of a link's shapes in the base frame; see ``link_points``."""
        place = self.place(link.get("name", ""))
        return np.asarray(link_points(link, place.rotation) @ place.rotation.T + place.translation)

    def reach(self, chain: list[int]) -> float:
        """Length of a chain from its first joint to its last [m]."""
        points: Vector = self.origins[chain]
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


_BEND = 0.25  #: Bend of the pitch joints of a leg, in the direction of larger range, for the rank of its Jacobian [rad]
_LEFT = re.compile(r"(?:^|[_\-.])l(?:eft)?(?:[_\-.]|$)|^L(?=[A-Z])|^LLEG|(?i:left)")
_RIGHT = re.compile(r"(?:^|[_\-.])r(?:ight)?(?:[_\-.]|$)|^R(?=[A-Z])|^RLEG|(?i:right)")


@dataclass(frozen=True, slots=True)
class Legs:
    """Joints of the left and the right leg, from hip to foot, by Pinocchio's index; excludes joints that move both."""

    left: tuple[int, ...]
    right: tuple[int, ...]

    @property
    def both(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Left, then right."""
        return self.left, self.right


def find_legs(skeleton: Skeleton, urdf: Path) -> Legs:
    """Find the two mirrored chains with the lowest ends, without joints shared by both; left is at +y.

    Raises ``RobotModelError`` if there are none.
    """
    base = skeleton.links(BASE)[0]
    leaves = [
        j
        for j in range(BASE + 1, skeleton.model.njoints)
        if not skeleton.children[j] and skeleton.origins[j][1] > 0.0 and skeleton.partners.get(j, j) != j
    ]
    hanging = {j: chain for j in leaves if (chain := _hanging(skeleton, j))}
    if not hanging:
        raise RobotModelError(
            f"{urdf}: no feet: no two mirrored chains of joints hang down from the base '{base}' or from a joint on "
            f"its middle plane{_unpaired(skeleton)}"
        )
    foot = min(hanging, key=lambda j: (round(float(skeleton.origins[j][2]), 3), -len(hanging[j])))
    left = hanging[foot]
    right = tuple(skeleton.partners[j] for j in left)
    try:
        freedoms(skeleton, left)
    except RobotModelError as error:
        raise RobotModelError(
            f"{urdf}: no feet: the leg that ends at joint '{skeleton.name(foot)}' has {error}"
        ) from error
    return Legs(left, right)


def freedoms(skeleton: Skeleton, leg: tuple[int, ...]) -> tuple[bool, bool, bool]:
    """Axes of the sole about which the bent leg turns it, for a sole aligned with the base; see ``leg_freedoms``."""
    model, data = skeleton.model, skeleton.model.createData()
    q: Vector = pin.neutral(model)
    for j in leg:
        if abs(float(skeleton.axes[j][1])) > _PARALLEL:
            low, high = _range(skeleton, j)
            q[int(model.joints[j].idx_q)] = min(_BEND, high) if high > -low else max(-_BEND, low)
    pin.computeJointJacobians(model, data, q)
    columns = pin.getJointJacobian(model, data, leg[-1], pin.LOCAL)[:, [int(model.joints[j].idx_v) for j in leg]]
    turn = skeleton.data.oMi[leg[-1]].rotation
    return leg_freedoms(np.vstack((turn @ columns[:3], turn @ columns[3:])), skeleton.reach(list(leg)))


def _hanging(skeleton: Skeleton, joint: int) -> tuple[int, ...]:
    """Chain to a joint, without joints shared with its mirror image; empty unless it leads below the base."""
    chain = skeleton.chain(joint)
    shared = [i for i, each in enumerate(chain) if skeleton.central(each)]
    chain = chain[shared[-1] + 1 :] if shared else chain
    top = min(float(skeleton.origins[chain[0]][2]), 0.0)
    return tuple(chain) if skeleton.origins[joint][2] < top - 0.5 * skeleton.reach(chain) else ()


def _unpaired(skeleton: Skeleton) -> str:
    names = [skeleton.name(j) for j in skeleton.children[BASE] if j not in skeleton.partners]
    return f"; without a mirror image: {named('joint', names)}" if names else ""


def named_left(skeleton: Skeleton, legs: Legs) -> bool | None:
    """Whether the leg at +y is named left; None if the names do not show it."""
    votes = 0
    for left, right in zip(legs.left, legs.right, strict=True):
        names = skeleton.name(left), skeleton.name(right)
        votes += bool(_LEFT.search(names[0]) and _RIGHT.search(names[1]))
        votes -= bool(_RIGHT.search(names[0]) and _LEFT.search(names[1]))
    return None if votes == 0 else votes > 0


def asymmetries(skeleton: Skeleton, tolerance: float) -> list[Finding]:
    """Joints without a mirror image, and partners whose limits differ by more than ``tolerance`` [rad], [-]."""
    model = skeleton.model
    alone = [skeleton.name(j) for j in range(BASE + 1, model.njoints) if j not in skeleton.partners]
    findings = found("note", "joint", alone, "no mirror image on the other side", "kept as it is")
    for joint, other in skeleton.partners.items():
        if joint == other or skeleton.origins[joint][1] < skeleton.origins[other][1]:
            continue
        faults = []
        mine, theirs = _range(skeleton, joint), _range(skeleton, other)
        if skeleton.signs[joint] < 0.0:
            theirs = -theirs[1], -theirs[0]
        if max(abs(a - b) for a, b in zip(mine, theirs, strict=True)) > tolerance:
            faults.append(
                f"ranges differ: [{mine[0]:.2f}, {mine[1]:.2f}] and, mirrored, [{theirs[0]:.2f}, {theirs[1]:.2f}] rad"
            )
        v, w = int(model.joints[joint].idx_v), int(model.joints[other].idx_v)
        for kind, unit, values in (("torque", "N.m", model.effortLimit), ("velocity", "rad/s", model.velocityLimit)):
            if abs(values[v] - values[w]) > tolerance * max(values[v], values[w]):
                faults.append(f"{kind} limits differ: {values[v]:g} and {values[w]:g} {unit}")
        names = [skeleton.name(joint), skeleton.name(other)] if faults else []
        findings += found("wrong", "joint", names, "; ".join(faults), "kept: check the URDF")
    return findings


def _range(skeleton: Skeleton, joint: int) -> tuple[float, float]:
    """Position limits of a joint [rad]."""
    q, model = int(skeleton.model.joints[joint].idx_q), skeleton.model
    return float(model.lowerPositionLimit[q]), float(model.upperPositionLimit[q])


_CAMERA = re.compile(r"camera|rgbd|realsense|d435|zed|gaze|eye", re.IGNORECASE)
_HEAD = re.compile(r"head|face", re.IGNORECASE)
_IMU = re.compile(r"imu|gyro|accelero|inertial_unit", re.IGNORECASE)

_FOREARM = 0.6  #: Minimum length of the last body of an arm that counts as a forearm, over the arm's reach [-]
_TIP = 0.1  #: Share of a forearm at its far end; the hand is at the mean of the points there [-]
_IMU_REACH = 0.5  #: Maximum distance of an IMU from the base, over the leg's length [-]
_HEAD_ABOVE = 1.2  #: Assumed height of a head without a link, over the height of the shoulders above the soles [-]


@dataclass(frozen=True, slots=True)
class Limbs:
    """All limbs except the legs."""

    arms: tuple[tuple[int, ...], tuple[int, ...]]  # left and right, from shoulder to hand; empty without arms
    torso: int  # joint that moves the torso; ``BASE`` if the base is the torso
    frames: dict[str, Frame]  # frames of the profile
    findings: tuple[Finding, ...]  # missing parts


def find_limbs(robot: ET.Element, skeleton: Skeleton, legs: Legs, floor: float) -> Limbs:
    """Find arms, torso, head and IMU; ``floor`` is the height of the soles in the base frame at zero [m]."""
    findings: list[Finding] = []
    arms = _arms(skeleton, legs)
    first = arms[0] or arms[1]
    torso = _trunk(skeleton, first)
    frames = {"torso": Frame(link=skeleton.links(torso)[0])}
    for side, arm in zip(FOOT_NAMES, arms, strict=True):
        if not arm:
            text = f"no {side} arm: no chain of joints on that side outside the legs"
            remedy = f"{side[0]}_wrist placed on the torso; motions use the other arm, or are refused"
            findings.append(Finding("note", f"link '{skeleton.links(torso)[0]}'", text, remedy))
    shoulder = skeleton.origins[first[0]][2] if first else skeleton.origins[torso][2]
    frames["gaze"] = _gaze(robot, skeleton, torso, floor + _HEAD_ABOVE * (float(shoulder) - floor), findings)
    for name, chain in zip(("l_wrist", "r_wrist"), arms, strict=True):
        frames[name] = _hand(robot, skeleton, chain) if chain else Frame(link=skeleton.links(torso)[0])
    frames["imu"] = _imu(skeleton, torso, skeleton.reach(list(legs.left)), findings)
    return Limbs(arms, torso, frames, tuple(findings))


def _arms(skeleton: Skeleton, legs: Legs) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The two mirrored chains with the longest reach, up to the fingers; else the longest chain without a partner.

    Left is at +y; a side without an arm is empty.
    """
    shoulders = [
        j
        for j in range(BASE + 1, skeleton.model.njoints)
        if not skeleton.central(j)
        and j not in (*legs.left, *legs.right)
        and (skeleton.model.parents[j] == BASE or skeleton.central(int(skeleton.model.parents[j])))
    ]
    chains: list[tuple[int, ...]] = []
    for joint in shoulders:
        chain, mirrored = [joint], joint in skeleton.partners
        while len(below := skeleton.children[chain[-1]]) == 1 and (below[0] in skeleton.partners) == mirrored:
            chain.append(below[0])
        chains.append(tuple(chain))
    pairs = [chain for chain in chains if chain[0] in skeleton.partners]
    longest = max(pairs or chains, key=lambda chain: (skeleton.reach(list(chain)), len(chain)), default=())
    other = tuple(skeleton.partners[j] for j in longest) if longest and longest[0] in skeleton.partners else ()
    on_left = bool(longest) and skeleton.origins[longest[0]][1] > 0.0
    return (longest, other) if on_left else (other, longest)


def _hand(robot: ET.Element, skeleton: Skeleton, arm: tuple[int, ...]) -> Frame:
    """Frame at the last joint of an arm; at the far end of its body if that is long, as below an elbow joint."""
    link, elements = skeleton.links(arm[-1])[0], links_by_name(robot)
    points = np.vstack([np.zeros((0, 3)), *(skeleton.points(elements[name]) for name in skeleton.links(arm[-1]))])
    distances = np.linalg.norm(points - skeleton.origins[arm[-1]], axis=1)
    if not len(points) or distances.max() < _FOREARM * skeleton.reach(list(arm)):
        return Frame(link=link)
    end = points[distances > (1.0 - _TIP) * distances.max()].mean(axis=0)
    x, y, z = (round(float(value), 3) + 0.0 for value in skeleton.place(link).actInv(end))
    return Frame(link=link, xyz=(x, y, z))


def _trunk(skeleton: Skeleton, arm: tuple[int, ...]) -> int:
    """Parent joint of the arms; without arms, the last central joint."""
    if arm:
        return int(skeleton.model.parents[arm[0]])
    joint = BASE
    while central := [j for j in skeleton.children[joint] if skeleton.central(j)]:
        joint = central[0]
    return joint


def _gaze(robot: ET.Element, skeleton: Skeleton, torso: int, height: float, findings: list[Finding]) -> Frame:
    """Frame at a camera, else at a link named head, else on top of torso, neck and head; x points forward."""
    middle = [j for j in skeleton.below(torso) if j == torso or all(map(skeleton.central, skeleton.chain(j)))]
    upper = [link for joint in middle for link in skeleton.links(joint)]  # links of torso, neck and head
    for pattern in (_CAMERA, _HEAD):
        matches = [link for link in upper if pattern.search(link)]
        if matches:
            return level(skeleton, max(matches, key=lambda link: float(skeleton.place(link).translation[2])))
    elements = links_by_name(robot)
    tops = {}
    for link in upper:
        points = skeleton.points(elements[link])
        tops[link] = float(points[:, 2].max()) if len(points) else float(skeleton.place(link).translation[2])
    link = max(tops, key=lambda name: tops[name])
    place = skeleton.place(link)
    top = max(tops[link], height)
    findings.append(Finding("note", f"link '{link}'", "no link is called head or camera", "gaze placed on top of it"))
    lift = place.actInv(np.array([place.translation[0], 0.0, top]))
    return level(skeleton, link, (round(float(lift[0]), 4), round(float(lift[1]), 4), round(float(lift[2]), 4)))


def _imu(skeleton: Skeleton, torso: int, leg: float, findings: list[Finding]) -> Frame:
    """Frame at an IMU link on base or torso near the base, else at the base; with the axes of the base."""
    base = skeleton.links(BASE)[0]
    for link in (link for joint in (BASE, torso) for link in skeleton.links(joint)):
        if not _IMU.search(link):
            continue
        away = float(np.linalg.norm(skeleton.place(link).translation))
        if away < _IMU_REACH * leg:
            return level(skeleton, link)
        text = f"an IMU {1e3 * away:.0f} mm from the base: joint noise times this distance is velocity noise"
        findings.append(Finding("note", f"link '{link}'", text, f"placed in link '{base}' instead"))
        return level(skeleton, base)
    findings.append(Finding("note", f"link '{base}'", "no link is called imu", "the IMU is placed here"))
    return level(skeleton, base)


def level(skeleton: Skeleton, link: str, xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Frame:
    """Frame on a link, aligned with the base in the zero posture."""
    angles = pin.rpy.matrixToRpy(skeleton.place(link).rotation.T)
    roll, pitch, yaw = (round(float(angle), 6) + 0.0 for angle in angles)
    return Frame(link=link, xyz=xyz, rpy=(roll, pitch, yaw))
