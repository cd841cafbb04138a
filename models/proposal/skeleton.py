"""The joints of a robot in its zero posture: where they are, how they turn, and which mirror each other."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from models.types import Matrix, Vector

BASE = 1
"""Pinocchio's index of the free flyer; the joints of the URDF follow."""

_MIRROR = np.array([1.0, -1.0, 1.0])  # reflection at the plane y = 0 of the base
_PARALLEL = 0.99  # least cosine between an axis and the image of its partner


class Skeleton:
    """Joints at zero, base upright at the origin.

    Reflected at the plane y = 0, a rotation by angle a about an axis u becomes one by -a about M u, M = diag(1, -1, 1).
    So partners satisfy p' = M p and u' = -s M u, and mirrored motions q' = s q.

    Args:
        model: Pinocchio model with a free flyer.
        tolerance: Largest distance of a joint from the image of its partner [m].

    Attributes:
        model: The model.
        data: Its workspace, at zero.
        origins: Origin of each joint in the base, by Pinocchio's index (njoints, 3) [m].
        axes: Axis of each joint in the base (njoints, 3).
        children: Joints that hang from each joint.
        partners: Joint that mirrors each joint; itself on the middle plane; joints without a partner are absent.
        signs: s of each joint in ``partners``.
    """

    def __init__(self, model: pin.Model, tolerance: float) -> None:
        self.model, self.data = model, model.createData()
        q = pin.neutral(model)
        pin.computeJointJacobians(model, self.data, q)
        pin.framesForwardKinematics(model, self.data, q)
        self.origins: Matrix = np.array([place.translation for place in self.data.oMi])
        self.axes: Matrix = np.zeros_like(self.origins)
        self.children: dict[int, list[int]] = {j: [] for j in range(model.njoints)}
        for j in range(BASE + 1, model.njoints):
            jacobian = pin.getJointJacobian(model, self.data, j, pin.LOCAL_WORLD_ALIGNED)
            self.axes[j] = jacobian[3:, model.joints[j].idx_v]
            self.children[int(model.parents[j])].append(j)
        self.partners: dict[int, int] = {BASE: BASE}
        self.signs: dict[int, float] = {}
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
        """Joints from the base to a joint, both ends included but the base itself."""
        return [int(j) for j in self.model.supports[joint] if j > BASE]

    def below(self, joint: int) -> list[int]:
        """A joint and all that hang from it."""
        return [joint, *(k for child in self.children[joint] for k in self.below(child))]

    def central(self, joint: int) -> bool:
        """Whether a joint is its own mirror image."""
        return self.partners.get(joint) == joint

    def links(self, joint: int) -> list[str]:
        """Links that a joint moves, those welded to each other, nearest first."""
        return [
            str(frame.name)
            for frame in self.model.frames
            if frame.parentJoint == joint and frame.type == pin.FrameType.BODY
        ]

    def place(self, link: str) -> pin.SE3:
        """Pose of a link in the base."""
        return self.data.oMf[self.model.getFrameId(link, pin.FrameType.BODY)]

    def reach(self, chain: list[int]) -> float:
        """Length of a chain from its first joint to its last [m]."""
        points: Vector = self.origins[chain]
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
