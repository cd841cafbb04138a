"""Conversion of MJCF to URDF: tree, inertias, limits and shapes of the compiled model, and data of the drives.

In a URDF the frame of a link lies at its joint. In MJCF the joint has an offset ``pos`` in the body, and the reference
position ``ref``. With body frame B, joint anchor p and axis u in B, and parent link at p_P in the parent body,

    link L = B shifted by p      T_PL(q = 0) = [-p_P] T_PB [p] R(u, -ref)      p_X in L = p_X in B - p

preserves joint positions, inertias and frames. Data that a URDF cannot express are returned separately.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from models.errors import RobotModelError
from models.proposal.shapes import MISSING, Description, DriveData, Finding, found
from models.types import Matrix, Vector

# As integers: MuJoCo's enumerations do not compare equal to the NumPy integers of a model.
_KINDS = {int(mujoco.mjtJoint.mjJNT_HINGE): "revolute", int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic"}
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_GEOM = mujoco.mjtGeom
_OF_JOINT = {int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)}
_CLOSED = {int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)}


def read_mjcf(path: Path) -> Description:
    """Robot of an MJCF file: the free-floating body with the most joints, else the child of the world with the most.

    Raises ``RobotModelError`` when MuJoCo refuses the file or a body cannot be a link: a ball joint, or several joints.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        findings = _drop_missing(spec)
        model = spec.compile()
    except ValueError as error:
        raise RobotModelError(f"{path}: MuJoCo refuses it: {error}") from error
    return _Converter(model, spec, path).convert(findings)


def _mesh_file(spec: Any, mesh: Any) -> Path:
    return Path(str(spec.modelfiledir), str(spec.meshdir or ""), str(mesh.file))


def _drop_missing(spec: Any) -> list[Finding]:
    """Delete textures, materials, and shapes whose mesh file is missing, so that the rest compiles."""
    for texture in list(spec.textures):
        spec.delete(texture)
    for material in list(spec.materials):
        spec.delete(material)
    missing = {mesh.name or Path(mesh.file).stem: mesh for mesh in spec.meshes if mesh.file}
    missing = {name: mesh for name, mesh in missing.items() if not _mesh_file(spec, mesh).is_file()}
    links = []
    for geom in list(spec.geoms):
        geom.material = ""
        if geom.meshname in missing:
            links.append(geom.parent.name)
            spec.delete(geom)
    for mesh in missing.values():
        spec.delete(mesh)
    return found("wrong", "link", links, MISSING, "left out")


class _Converter:
    """Converter of one compiled model."""

    def __init__(self, model: Any, spec: Any, path: Path) -> None:
        self._model, self._spec, self._path = model, spec, path
        self._robot = ET.Element("robot", {"name": str(spec.modelname or path.stem)})
        self._anchors = {0: np.zeros(3)}  # joint anchor of each body (3,) [m]
        self._drives: dict[str, DriveData] = {}

    def convert(self, findings: list[Finding]) -> Description:
        base = self._base()
        for body in range(base, self._model.nbody):
            if int(self._model.body_rootid[body]) == int(self._model.body_rootid[base]):
                self._add_link(body)
                if body == base:
                    self._anchors[body] = np.zeros(3)
                else:
                    self._add_joint(body)
        self._add_imus()
        closed = [
            self._model.equality(i).name or str(i)
            for i in range(self._model.neq)
            if int(self._model.eq_type[i]) in _CLOSED
        ]
        findings += found("wrong", "equality", closed, "a closed chain, which a URDF cannot describe", "left open")
        return Description(self._robot, self._drives, tuple(findings))

    def _base(self) -> int:
        model = self._model
        joints = np.bincount(model.body_rootid[model.jnt_bodyid], minlength=model.nbody)
        free = [int(body) for body, kind in zip(model.jnt_bodyid, model.jnt_type, strict=True) if kind == _FREE]
        roots = free or [i for i in range(1, model.nbody) if model.body_parentid[i] == 0 and model.body_jntnum[i] == 0]
        if not roots or not joints[roots].max() > len(free[:1]):
            raise RobotModelError(f"{self._path}: no robot: no body below the world has moving joints and a free base")
        return max(roots, key=lambda body: int(joints[body]))

    def _name(self, body: int) -> str:
        return str(self._model.body(body).name) or f"body_{body}"

    def _joint_name(self, joint: int) -> str:
        return str(self._model.joint(joint).name) or f"joint_{joint}"

    def _add_link(self, body: int) -> None:
        model, link = self._model, ET.SubElement(self._robot, "link", name=self._name(body))
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        self._anchors[body] = np.array(model.jnt_pos[first]) if count else np.zeros(3)
        if model.body_mass[body] > 0.0:
            inertial = ET.SubElement(link, "inertial")
            _origin(inertial, model.body_ipos[body] - self._anchors[body], model.body_iquat[body])
            ET.SubElement(inertial, "mass", value=_text(model.body_mass[body]))
            xx, yy, zz = map(_text, model.body_inertia[body])  # a flat body's is at its bound: rotation would round it
            ET.SubElement(inertial, "inertia", ixx=xx, iyy=yy, izz=zz, ixy="0", ixz="0", iyz="0")
        first = int(model.body_geomadr[body])
        touching = {int(g) for pair in (model.pair_geom1, model.pair_geom2) for g in pair}
        for geom in range(first, first + int(model.body_geomnum[body])):
            collides = bool(model.geom_contype[geom] or model.geom_conaffinity[geom]) or geom in touching
            for pose, shape in self._shapes(geom):
                element = ET.SubElement(link, "collision" if collides else "visual")
                _origin(element, pose.translation - self._anchors[body], _wxyz(pose.rotation))
                ET.SubElement(element, "geometry").append(shape)

    def _shapes(self, geom: int) -> Iterator[tuple[pin.SE3, ET.Element]]:
        """Shapes that represent a geom, with their poses in its body."""
        model, kind = self._model, _GEOM(int(self._model.geom_type[geom]))
        pose, (x, y, z) = _pose(model.geom_pos[geom], model.geom_quat[geom]), model.geom_size[geom].tolist()
        if kind == _GEOM.mjGEOM_SPHERE:
            yield pose, ET.Element("sphere", radius=_text(x))
        elif kind in (_GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_CAPSULE):
            yield pose, ET.Element("cylinder", radius=_text(x), length=_text(2.0 * y))
            for end in (-y, y) if kind == _GEOM.mjGEOM_CAPSULE else ():
                yield pose * pin.SE3(np.eye(3), np.array([0.0, 0.0, end])), ET.Element("sphere", radius=_text(x))
        elif kind in (_GEOM.mjGEOM_BOX, _GEOM.mjGEOM_ELLIPSOID):
            yield pose, ET.Element("box", size=" ".join(_text(2.0 * side) for side in (x, y, z)))
        elif kind == _GEOM.mjGEOM_MESH:
            mesh = int(model.geom_dataid[geom])
            file = self._spec.mesh(model.mesh(mesh).name).file
            if file:
                path = _mesh_file(self._spec, self._spec.mesh(model.mesh(mesh).name))
                moved = _pose(model.mesh_pos[mesh], model.mesh_quat[mesh])  # by the compiler, to principal axes
                scale = " ".join(_text(value) for value in model.mesh_scale[mesh])
                yield pose * moved.inverse(), ET.Element("mesh", filename=str(path.resolve()), scale=scale)

    def _add_joint(self, body: int) -> None:
        model, parent = self._model, int(self._model.body_parentid[body])
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        kinds = [_KINDS.get(int(model.jnt_type[j])) for j in range(first, first + count)]
        if count > 1 or None in kinds:
            what = f"{count} joints" if count > 1 else "a ball joint"
            raise RobotModelError(f"{self._path}: body '{self._name(body)}' has {what}; one hinge each is supported")
        place = _pose(model.body_pos[body], model.body_quat[body])
        place.translation = place.translation - self._anchors[parent] + place.rotation @ self._anchors[body]
        name = self._joint_name(first) if count else f"{self._name(body)}_fixed"
        joint = ET.SubElement(self._robot, "joint", name=name, type=kinds[0] or "fixed" if count else "fixed")
        ET.SubElement(joint, "parent", link=self._name(parent))
        ET.SubElement(joint, "child", link=self._name(body))
        if count:
            axis = np.array(model.jnt_axis[first])
            if kinds[0] == "revolute":
                place.rotation = place.rotation @ pin.exp3(-model.qpos0[model.jnt_qposadr[first]] * axis)
            ET.SubElement(joint, "axis", xyz=" ".join(map(_text, axis)))
            self._add_limits(joint, first)
            v = int(model.jnt_dofadr[first])
            self._drives[name] = DriveData(
                float(model.dof_armature[v]), float(np.ravel(model.dof_damping[v])[0]), float(model.dof_frictionloss[v])
            )
        _origin(joint, place.translation, _wxyz(place.rotation))

    def _add_limits(self, joint: ET.Element, index: int) -> None:
        """Add limits of range and torque, and mimic elements; ``repair_joints`` fills missing limits."""
        model, limit = self._model, ET.SubElement(joint, "limit")
        if model.jnt_limited[index]:
            lower, upper = model.jnt_range[index]
            limit.set("lower", _text(lower))
            limit.set("upper", _text(upper))
        torques = [self._torque(i) for i in range(model.nu) if self._drives_joint(i, index)]
        most = sum(torques) if torques else 0.0
        if model.jnt_actfrclimited[index]:
            most = min(most or np.inf, float(np.abs(model.jnt_actfrcrange[index]).max()))
        if np.isfinite(most) and most > 0.0:
            limit.set("effort", _text(most))
        for i in range(model.neq):
            follows = int(model.eq_type[i]) == int(mujoco.mjtEq.mjEQ_JOINT) and int(model.eq_obj1id[i]) == index
            if follows and int(model.eq_obj2id[i]) >= 0:
                ET.SubElement(joint, "mimic", joint=self._joint_name(int(model.eq_obj2id[i])))

    def _drives_joint(self, actuator: int, joint: int) -> bool:
        kind, target = int(self._model.actuator_trntype[actuator]), int(self._model.actuator_trnid[actuator][0])
        return kind in _OF_JOINT and target == joint

    def _torque(self, actuator: int) -> float:
        """Maximum torque of an actuator [N.m]; infinite without a limit."""
        model, most = self._model, np.inf
        if model.actuator_forcelimited[actuator]:
            most = float(np.abs(model.actuator_forcerange[actuator]).max())
        torque = int(model.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_NONE)  # not a position servo
        if torque and model.actuator_ctrllimited[actuator]:
            gain = abs(float(model.actuator_gainprm[actuator][0]))
            most = min(most, gain * float(np.abs(model.actuator_ctrlrange[actuator]).max()))
        return most * abs(float(model.actuator_gear[actuator][0]))

    def _add_imus(self) -> None:
        """Add a massless link at each site that has a gyro or is named like an IMU."""
        model, links = self._model, {link.get("name") for link in self._robot.findall("link")}
        gyros = model.sensor_type == int(mujoco.mjtSensor.mjSENS_GYRO)
        sites = {int(i) for i in model.sensor_objid[gyros]}
        sites |= {i for i in range(model.nsite) if "imu" in model.site(i).name.lower()}
        for site in sorted(sites):
            body, name = int(model.site_bodyid[site]), str(model.site(site).name) or f"site_{site}"
            if self._name(body) not in links:
                continue
            name = name if "imu" in name.lower() else f"imu_{name}"
            while name in links:
                name += "_site"
            links.add(name)
            ET.SubElement(self._robot, "link", name=name)
            joint = ET.SubElement(self._robot, "joint", name=f"{name}_fixed", type="fixed")
            ET.SubElement(joint, "parent", link=self._name(body))
            ET.SubElement(joint, "child", link=name)
            _origin(joint, model.site_pos[site] - self._anchors[body], model.site_quat[site])


def _pose(position: Vector, wxyz: Vector) -> pin.SE3:
    w, x, y, z = (float(value) for value in wxyz)
    return pin.SE3(pin.Quaternion(w, x, y, z).toRotationMatrix(), np.array(position, dtype=float))


def _wxyz(rotation: Matrix) -> Vector:
    return np.roll(pin.Quaternion(rotation).coeffs(), 1)


def _origin(element: ET.Element, position: Vector, wxyz: Vector) -> None:
    rpy = pin.rpy.matrixToRpy(_pose(position, wxyz).rotation)
    ET.SubElement(element, "origin", xyz=" ".join(map(_text, position)), rpy=" ".join(map(_text, rpy)))


def _text(value: float) -> str:
    return repr(float(value) + 0.0)  # no -0
