"""Which two chains of joints are the legs, and which way the robot looks."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from models.errors import RobotModelError
from models.proposal.findings import Finding, named
from models.proposal.skeleton import BASE, Skeleton

LEG_JOINTS = 6
"""Joints that a leg needs to keep its sole flat wherever the base goes."""

_LEFT = re.compile(r"(?:^|[_\-.])l(?:eft)?(?:[_\-.]|$)|^L(?=[A-Z])|^LLEG|(?i:left)")
_RIGHT = re.compile(r"(?:^|[_\-.])r(?:ight)?(?:[_\-.]|$)|^R(?=[A-Z])|^RLEG|(?i:right)")


@dataclass(frozen=True, slots=True)
class Legs:
    """Joints of the left and the right leg from base to foot, by Pinocchio's index."""

    left: tuple[int, ...]
    right: tuple[int, ...]

    @property
    def both(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Left, then right."""
        return self.left, self.right


def find_legs(skeleton: Skeleton, urdf: Path) -> Legs:
    """The two mirrored chains that hang from the base itself and reach lowest; left is on the side of +y.

    Raises:
        RobotModelError: There is no such pair (the robot has no feet), or a leg has too few joints.
    """
    base = skeleton.links(BASE)[0]
    leaves = [
        j
        for j in range(BASE + 1, skeleton.model.njoints)
        if not skeleton.children[j] and skeleton.origins[j][1] > 0.0 and skeleton.partners.get(j, j) != j
    ]
    hanging = [j for j in leaves if _apart(skeleton, j) and _below(skeleton, j)]
    if not hanging:
        raise RobotModelError(
            f"{urdf}: no feet: no two mirrored chains of joints hang down from the base '{base}'{_lonely(skeleton)}"
        )
    foot = min(hanging, key=lambda j: (round(float(skeleton.origins[j][2]), 3), -len(skeleton.chain(j))))
    left = tuple(skeleton.chain(foot))
    right = tuple(skeleton.partners[j] for j in left)
    if len(left) < LEG_JOINTS:
        raise RobotModelError(
            f"{urdf}: no feet: the leg that ends at joint '{skeleton.name(foot)}' has {len(left)} joints, and a sole "
            f"stays flat with {LEG_JOINTS}"
        )
    return Legs(left, right)


def _apart(skeleton: Skeleton, joint: int) -> bool:
    """Whether the chain to a joint and its mirror image share nothing but the base."""
    return not any(skeleton.central(j) for j in skeleton.chain(joint))


def _below(skeleton: Skeleton, joint: int) -> bool:
    chain = skeleton.chain(joint)
    return bool(skeleton.origins[joint][2] < skeleton.origins[chain[0]][2] - 0.5 * skeleton.reach(chain))


def _lonely(skeleton: Skeleton) -> str:
    """The joints at the base that have no partner, for the message."""
    names = [skeleton.name(j) for j in skeleton.children[BASE] if j not in skeleton.partners]
    return f"; without a mirror image: {named('joint', names)}" if names else ""


def named_left(skeleton: Skeleton, legs: Legs) -> bool | None:
    """Whether the leg at +y is called left; None where the names do not say."""
    votes = 0
    for left, right in zip(legs.left, legs.right, strict=True):
        names = skeleton.name(left), skeleton.name(right)
        votes += bool(_LEFT.search(names[0]) and _RIGHT.search(names[1]))
        votes -= bool(_RIGHT.search(names[0]) and _LEFT.search(names[1]))
    return None if votes == 0 else votes > 0


def asymmetries(skeleton: Skeleton, tolerance: float) -> list[Finding]:
    """Joints without a mirror image, and partners whose limits differ.

    Args:
        skeleton: The joints.
        tolerance: Largest difference that counts as equal: of positions [rad], of others over the value itself [-].
    """
    model = skeleton.model
    findings = []
    alone = [skeleton.name(j) for j in range(BASE + 1, model.njoints) if j not in skeleton.partners]
    if alone:
        findings.append(Finding("note", named("joint", alone), "no mirror image on the other side", "kept as it is"))
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
        if faults:
            names = named("joint", [skeleton.name(joint), skeleton.name(other)])
            findings.append(Finding("wrong", names, "; ".join(faults), "kept: check the URDF"))
    return findings


def _range(skeleton: Skeleton, joint: int) -> tuple[float, float]:
    """Position limits of a joint [rad]."""
    q, model = int(skeleton.model.joints[joint].idx_q), skeleton.model
    return float(model.lowerPositionLimit[q]), float(model.upperPositionLimit[q])
