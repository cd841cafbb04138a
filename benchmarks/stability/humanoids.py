"""Humanoids made of boxes, as URDF text: kinds of robots that no package contains."""

from dataclasses import dataclass
from pathlib import Path

SIDES = {"left": 1.0, "right": -1.0}
_AXES = {"roll": "1 0 0", "pitch": "0 1 0", "yaw": "0 0 1"}
_ROUND = (0.06, 0.06, 0.06)
Triple = tuple[float, float, float]


class _Urdf:
    """URDF text of links and joints."""

    def __init__(self) -> None:
        self.parts: list[str] = []

    def link(self, name: str, mass: float, size: Triple = _ROUND, centre: Triple = (0.0, 0.0, 0.0)) -> str:
        """Add a box of uniform density."""
        (x, y, z), at = size, " ".join(map(str, centre))
        ixx, iyy, izz = (mass * (a * a + b * b) / 12.0 for a, b in ((y, z), (x, z), (x, y)))
        box = f'<origin xyz="{at}"/><geometry><box size="{x} {y} {z}"/></geometry>'
        self.parts.append(
            f'<link name="{name}"><inertial><origin xyz="{at}"/><mass value="{mass}"/>'
            f'<inertia ixx="{ixx:.6g}" iyy="{iyy:.6g}" izz="{izz:.6g}" ixy="0" ixz="0" iyz="0"/></inertial>'
            f"<visual>{box}</visual><collision>{box}</collision></link>"
        )
        return name

    def joint(
        self, name: str, axis: str, parent: str, child: str, at: Triple, limits: tuple[float, float], torque: float
    ) -> None:
        """Add a revolute joint about roll, pitch or yaw."""
        self.parts.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{" ".join(map(str, at))}"/><axis xyz="{_AXES[axis]}"/>'
            f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="{torque}" velocity="15"/></joint>'
        )


@dataclass(frozen=True)
class Humanoid:
    """Robot of about 1.3 m and 45 kg with legs of 0.76 m."""

    ankle_roll: bool = True  # without it, the legs have one joint less
    hip_yaw: bool = True  # without it, the legs have one joint less
    waist_legs: bool = False  # the base is the trunk, and the legs are attached to a pelvis below two waist joints
    arms: tuple[str, ...] = ("left", "right")
    arm_joints: int = 4  # number of joints, starting at the shoulder
    arm: float = 0.5  # shoulder to end of the arm [m]
    head: bool = True
    ankle: float = 70.0  # torque limit of the ankles [N.m]
    knee: float = 200.0  # torque limit of the knees [N.m]

    def write(self, folder: Path) -> Path:
        """Write the URDF and return its path."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "humanoid.urdf"
        path.write_text(self.text())
        return path

    def text(self) -> str:
        """Return the URDF."""
        urdf = _Urdf()
        trunk = (15.0, (0.16, 0.26, 0.36), (0.0, 0.0, 0.2))
        if self.waist_legs:
            urdf.link("trunk", *trunk)
            urdf.link("waist", 1.0)
            urdf.joint("waist_yaw", "yaw", "trunk", "waist", (0.0, 0.0, 0.0), (-1.5, 1.5), 80.0)
            urdf.link("pelvis", 4.0, (0.12, 0.2, 0.1), (0.0, 0.0, -0.05))
            urdf.joint("waist_roll", "roll", "waist", "pelvis", (0.0, 0.0, -0.03), (-0.5, 0.5), 80.0)
        else:
            urdf.link("pelvis", 5.0, (0.06, 0.2, 0.06), (0.0, 0.0, 0.04))
            urdf.link("trunk", *trunk)
            urdf.joint("waist_yaw", "yaw", "pelvis", "trunk", (0.0, 0.0, 0.05), (-1.5, 1.5), 80.0)
        if self.head:
            urdf.link("head", 2.0, (0.14, 0.14, 0.18), (0.0, 0.0, 0.1))
            urdf.joint("head_yaw", "yaw", "trunk", "head", (0.0, 0.0, 0.4), (-1.0, 1.0), 8.0)
        for side, sign in SIDES.items():
            self._leg(urdf, side, sign)
            if side in self.arms:
                self._arm(urdf, side, sign)
        return '<robot name="humanoid">\n' + "\n".join(urdf.parts) + "\n</robot>\n"

    def _leg(self, urdf: _Urdf, side: str, sign: float) -> None:
        """Add hip yaw, roll and pitch, knee, ankle pitch and roll."""
        here, roll = (0.0, 0.0, 0.0), (-0.4, 0.8) if sign > 0.0 else (-0.8, 0.4)
        hip, place = "pelvis", (0.0, 0.1 * sign, -0.06)
        if self.hip_yaw:
            hip = urdf.link(f"{side}_hip", 1.0)
            urdf.joint(f"{side}_hip_yaw", "yaw", "pelvis", hip, place, (-0.8, 0.8), 120.0)
            place = here
        side_hip = urdf.link(f"{side}_hip_side", 1.0)
        urdf.joint(f"{side}_hip_roll", "roll", hip, side_hip, place, roll, 150.0)
        thigh = urdf.link(f"{side}_thigh", 4.0, (0.1, 0.09, 0.3), (0.0, 0.0, -0.16))
        urdf.joint(f"{side}_hip_pitch", "pitch", side_hip, thigh, here, (-2.0, 1.2), 150.0)
        shank = urdf.link(f"{side}_shank", 2.0, (0.08, 0.08, 0.3), (0.0, 0.0, -0.17))
        urdf.joint(f"{side}_knee", "pitch", thigh, shank, (0.0, 0.0, -0.35), (-0.1, 2.2), self.knee)
        width = 0.08 if self.ankle_roll else 0.035  # a sole without ankle roll is narrow
        foot, ankle = (0.8, (0.2, width, 0.03), (0.03, 0.0, -0.06)), (0.0, 0.0, -0.35)
        if self.ankle_roll:
            cross = urdf.link(f"{side}_cross", 0.3, (0.05, 0.05, 0.05))
            urdf.joint(f"{side}_ankle_pitch", "pitch", shank, cross, ankle, (-0.9, 0.7), self.ankle)
            urdf.joint(
                f"{side}_ankle_roll", "roll", cross, urdf.link(f"{side}_foot", *foot), here, (-0.4, 0.4), self.ankle
            )
        else:
            urdf.joint(
                f"{side}_ankle_pitch", "pitch", shank, urdf.link(f"{side}_foot", *foot), ankle, (-0.9, 0.7), 70.0
            )

    def _arm(self, urdf: _Urdf, side: str, sign: float) -> None:
        """Add the first ``arm_joints`` of shoulder pitch, roll and yaw, elbow, wrist yaw."""
        half, here = 0.5 * self.arm, (0.0, 0.0, 0.0)
        roll = (-0.3, 2.8) if sign > 0.0 else (-2.8, 0.3)
        chain = (
            ("shoulder_pitch", "pitch", (0.0, 0.2 * sign, 0.34), (-3.0, 2.0)),
            ("shoulder_roll", "roll", here, roll),
            ("shoulder_yaw", "yaw", here, (-2.5, 2.5)),
            ("elbow", "pitch", (0.0, 0.0, -half), (-2.4, 0.1)),
            ("wrist_yaw", "yaw", (0.0, 0.0, -half), (-1.5, 1.5)),
        )
        above = "trunk"
        for number, (kind, axis, at, limits) in enumerate(chain[: self.arm_joints]):
            last = number == self.arm_joints - 1  # the last link is a forearm of 0.2 m
            size, centre = ((0.05, 0.05, 0.2), (0.0, 0.0, -0.1)) if last else (_ROUND, here)
            link = urdf.link(f"{side}_{kind}_link", 0.6, size, centre)
            urdf.joint(f"{side}_{kind}", axis, above, link, at, limits, 40.0)
            above = link


#: Robots by kind
KINDS = {
    "six-joint legs": Humanoid(),
    "legs below a waist": Humanoid(waist_legs=True),
    "five-joint legs, no ankle roll": Humanoid(ankle_roll=False),
    "five-joint legs, no hip yaw": Humanoid(hip_yaw=False),
    "four-joint legs": Humanoid(ankle_roll=False, hip_yaw=False),
    "ankles of 8 N.m": Humanoid(ankle=8.0),
    "knees of 35 N.m": Humanoid(knee=35.0),
    "one arm": Humanoid(arms=("left",)),
    "no arms, no head": Humanoid(arms=(), head=False),
    "arms of two joints": Humanoid(arm_joints=2),
}
