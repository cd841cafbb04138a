"""MJCF becomes a URDF that has the dynamics, the limits and the shapes of the compiled model, and keeps its drives."""

import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from benchmarks.stability.humanoids import Humanoid
from models.errors import RobotModelError
from models.mujoco_model import build_mujoco
from models.proposal.mjcf import read_mjcf
from models.proposal.profile_text import write_proposal
from models.proposal.propose import propose
from models.proposal.shapes import Description
from models.robot_model import RobotModel

#: Frames beside the joints, a joint that is zero elsewhere, full inertias, a mesh that the compiler moves
_TRAPS = """
<mujoco model="traps">
  <compiler angle="degree" meshdir="parts"/>
  <default>
    <joint armature="0.02" damping="0.3" frictionloss="0.1"/>
    <default class="seen"><geom contype="0" conaffinity="0"/></default>
  </default>
  <asset><mesh name="wedge" file="wedge.obj" scale="0.1 0.2 0.3"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="crate" pos="2 0 0"><freejoint/><geom size="0.1"/></body>
    <body name="base" pos="0 0 1">
      <freejoint/>
      <inertial pos="0.01 0.02 0.03" mass="4" fullinertia="0.05 0.06 0.07 0.01 0.002 -0.003"/>
      <site name="chip" pos="0.02 0 0.1"/>
      <body name="upper" pos="0.1 0.2 -0.1" euler="20 -30 40">
        <joint name="turn" axis="0 1 1" pos="0.03 0 0.05" range="-50 70" ref="25"/>
        <geom type="capsule" fromto="0 0 0 0.1 0 -0.3" size="0.04" mass="1.5"/>
        <geom class="seen" type="mesh" mesh="wedge" pos="0.1 0 0" euler="0 90 10" mass="0"/>
        <body name="bracket" pos="0 0 -0.3">
          <geom type="box" size="0.02 0.03 0.04" mass="0.2"/>
          <body name="lower" pos="0.05 0 0" euler="90 0 0">
            <joint name="bend" axis="1 0 0" pos="0 0.1 0"/>
            <joint name="slide" type="slide" axis="1 0 0"/>
            <geom type="sphere" size="0.05" pos="0 0.1 0.1" mass="0.7"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <sensor><gyro site="chip"/></sensor>
  <actuator>
    <motor joint="turn" gear="20" ctrllimited="true" ctrlrange="-2 1.5"/>
    <position joint="bend" kp="100" forcelimited="true" forcerange="-30 30"/>
  </actuator>
</mujoco>
"""
_WEDGE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
_ONE_JOINT = _TRAPS.replace('<joint name="slide" type="slide" axis="1 0 0"/>', "")


def _write(folder: Path, text: str) -> Path:
    (folder / "parts").mkdir()
    (folder / "parts" / "wedge.obj").write_text(_WEDGE)
    (folder / "robot.xml").write_text(text)
    return folder / "robot.xml"


@pytest.fixture
def read(tmp_path: Path) -> tuple[Description, mujoco.MjModel]:
    path = _write(tmp_path, _ONE_JOINT)
    return read_mjcf(path), mujoco.MjModel.from_xml_path(str(path))


def _limit(robot: ET.Element, joint: str) -> dict[str, float]:
    element = robot.find(f"joint[@name='{joint}']/limit")
    assert element is not None
    return {key: float(value) for key, value in element.items()}


def test_limits_and_drives_are_those_of_the_file(read: tuple[Description, mujoco.MjModel]) -> None:
    found = read[0]
    assert _limit(found.robot, "turn") == pytest.approx({"lower": -0.8727, "upper": 1.2217, "effort": 40.0}, abs=1e-4)
    assert _limit(found.robot, "bend") == {"effort": 30.0}
    drive = found.drives["turn"]
    assert (drive.armature, drive.damping, drive.frictionloss) == (0.02, 0.3, 0.1)
    assert found.robot.find("link[@name='crate']") is None and found.robot.find("link[@name='imu_chip']") is not None


def test_shapes_are_where_mujoco_has_them(read: tuple[Description, mujoco.MjModel]) -> None:
    found, model = read
    mesh = found.robot.find("link[@name='upper']/visual/geometry/mesh")
    assert mesh is not None and Path(mesh.get("filename", "")).is_file()
    scale = np.array([float(value) for value in (mesh.get("scale") or "").split()])
    vertices = np.array([[float(x) for x in line.split()[1:]] for line in _WEDGE.splitlines() if line[0] == "v"])
    origin = found.robot.find("link[@name='upper']/visual/origin")
    assert origin is not None
    xyz, rpy = (np.array([float(x) for x in (origin.get(key) or "").split()]) for key in ("xyz", "rpy"))
    mine = pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)
    geom = next(i for i in range(model.ngeom) if model.geom_dataid[i] >= 0)
    compiled = pin.SE3(pin.Quaternion(*model.geom_quat[geom].tolist()).toRotationMatrix(), model.geom_pos[geom])
    anchor = np.array([0.03, 0.0, 0.05])
    theirs = np.array([compiled.act(vertex) - anchor for vertex in model.mesh_vert.astype(float)])
    for vertex in vertices:
        assert np.linalg.norm(theirs - mine.act(vertex * scale), axis=1).min() < 1e-6
    assert len(found.robot.findall("link[@name='upper']/collision")) == 3  # a capsule: a cylinder and two spheres


def test_dynamics_are_those_of_mujoco(read: tuple[Description, mujoco.MjModel]) -> None:
    rng, (found, model) = np.random.default_rng(3), read
    for joint in found.robot.findall("joint"):
        limit = joint.find("limit")
        if limit is not None:
            limit.attrib.update(velocity="1", effort="1", **{"lower": "-9", "upper": "9"})
    mine = pin.buildModelFromXML(ET.tostring(found.robot, encoding="unicode"), pin.JointModelFreeFlyer())
    mine.armature = np.array([0.0] * 6 + [found.drives[name].armature for name in list(mine.names)[2:]])
    data, theirs = mine.createData(), mujoco.MjData(model)
    base = model.body("base").id
    own, v = int(model.body("base").jntadr[0]), int(model.body("base").dofadr[0])
    for _ in range(5):
        turn = rng.normal(size=4)
        q = np.concatenate([rng.uniform(-1.0, 1.0, 3), turn / np.linalg.norm(turn), rng.uniform(-1.0, 1.0, 2)])
        start = int(model.jnt_qposadr[own])
        theirs.qpos[start : start + 3], theirs.qpos[start + 3 : start + 7] = q[:3], np.roll(q[3:7], 1)
        for name in ("turn", "bend"):
            theirs.qpos[model.joint(name).qposadr[0]] = q[mine.idx_qs[mine.getJointId(name)]]
        mujoco.mj_forward(model, theirs)
        assert pin.centerOfMass(mine, data, q) == pytest.approx(theirs.subtree_com[base], abs=1e-9)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, theirs, full)
        turned = np.eye(8)
        turned[:3, :3] = pin.Quaternion(q[3:7]).toRotationMatrix()
        order = [*range(6), *(mine.idx_vs[mine.getJointId(name)] for name in ("turn", "bend"))]
        block = turned.T @ full[v : v + 8, v : v + 8] @ turned
        upper = np.triu(pin.crba(mine, data, q))
        assert (upper + np.triu(upper, 1).T)[np.ix_(order, order)] == pytest.approx(block, abs=1e-8)


def test_a_body_with_two_joints_is_refused(tmp_path: Path) -> None:
    path = _write(tmp_path, _TRAPS)
    with pytest.raises(RobotModelError, match=r"robot\.xml: body 'lower' has 2 joints; one hinge each"):
        read_mjcf(path)


def test_a_missing_mesh_is_left_out(tmp_path: Path) -> None:
    path = _write(tmp_path, _ONE_JOINT)
    (tmp_path / "parts" / "wedge.obj").unlink()
    found = read_mjcf(path)
    assert [finding.culprit for finding in found.findings] == ["link 'upper'"]
    assert found.robot.find("link[@name='upper']/visual") is None


def test_the_profile_has_the_robot_of_the_file(tmp_path: Path) -> None:
    """A humanoid as MuJoCo writes it, with position servos and without velocity limits."""
    urdf = Humanoid().text().replace("<link", '<mujoco><compiler fusestatic="false"/></mujoco><link', 1)
    spec = mujoco.MjSpec.from_string(urdf)
    spec.body("pelvis").add_freejoint()
    for number, joint in enumerate(joint for joint in spec.joints if joint.name):
        joint.armature, joint.frictionloss = 0.01 + 0.0001 * (number % 3), 0.2
        servo = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=50.0)
        servo.forcelimited, servo.forcerange = True, [-60.0, 60.0]
        joint.actfrclimited = False
    path = tmp_path / "humanoid.xml"
    original = spec.compile()
    path.write_text(spec.to_xml())
    files = write_proposal(propose(path), tmp_path / "out" / "mine.yaml")
    model = RobotModel.load(files[0])
    assert model.mass == pytest.approx(float(original.body_mass.sum()))
    assert model.tau_max == pytest.approx(60.0) and model.frictionloss == pytest.approx(0.2)
    armature = {
        original.joint(int(j)).name: original.dof_armature[original.jnt_dofadr[j]] for j in range(original.njnt)
    }
    assert model.armature == pytest.approx([armature[name] for name in model.joint_names])
    plant = build_mujoco(model).model
    assert float(plant.body_mass.sum()) == pytest.approx(model.mass)
