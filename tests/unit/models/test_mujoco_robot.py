"""The simulated robot: soles, motors, friction, a fall, and what its builder may change or refuses."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from models.constants import GRAVITY
from models.errors import ConfigError
from models.mujoco_model import MujocoModel, build_mujoco, mujoco_to_pin
from models.mujoco_spec import CAMERA
from models.robot_model import RobotModel
from tests.mujoco_states import built, placed, random_state


def _stand(robot: RobotModel, mj: MujocoModel, seconds: float, push: float = 0.0) -> mujoco.MjData:
    """Stand under stiff joint PD; ``push`` is a sideways force on the base [N]."""
    data = placed(robot, mj, robot.standing_configuration(), np.zeros(robot.nv))
    q = robot.posture("stand")
    for _ in range(round(seconds / mj.model.opt.timestep)):
        error = q - data.qpos[mj.joint_qpos]
        data.ctrl[mj.actuator] = 8.0 * robot.kp * error - 2.0 * robot.kd * data.qvel[mj.joint_qvel]
        data.xfrc_applied[mj.base_body, 1] = push
        mujoco.mj_step(mj.model, data)
    return data


@pytest.mark.parametrize("push", [0.0, 15.0])
def test_foot_wrenches_carry_the_robot(robot: RobotModel, mj: MujocoModel, push: float) -> None:
    """At rest the measured wrenches, taken to the world, balance gravity and the push: signs, frames and origins."""
    data = _stand(robot, mj, 8.0, push)
    wrenches = mj.foot_wrenches(data)
    assert wrenches.shape == (2, 6) and (wrenches[:, 2] > 0.2 * robot.mass * GRAVITY).all()
    if push:
        assert wrenches[1, 2] > wrenches[0, 2] + 20.0 or wrenches[0, 2] > wrenches[1, 2] + 20.0
    total = pin.Force.Zero()
    for site, wrench in zip(mj.sole_sites, wrenches, strict=True):
        placement = pin.SE3(data.site_xmat[site].reshape(3, 3), data.site_xpos[site])
        total = total + placement.act(pin.Force(wrench))
    force = np.array([0.0, push, -robot.mass * GRAVITY])
    moment = np.cross(data.subtree_com[mj.base_body], [0.0, 0.0, -robot.mass * GRAVITY])
    moment += np.cross(data.xipos[mj.base_body], [0.0, push, 0.0])
    np.testing.assert_allclose(total.linear, -force, atol=0.002 * robot.mass * GRAVITY)
    np.testing.assert_allclose(total.angular, -moment, atol=0.002 * robot.mass * GRAVITY)


def test_feet_neither_chatter_nor_creep(robot: RobotModel, mj: MujocoModel) -> None:
    data = _stand(robot, mj, 2.0)
    start = data.site_xpos[list(mj.sole_sites)].copy()
    q, speeds = robot.posture("stand"), []
    for _ in range(2000):
        error = q - data.qpos[mj.joint_qpos]
        data.ctrl[mj.actuator] = 8.0 * robot.kp * error - 2.0 * robot.kd * data.qvel[mj.joint_qvel]
        mujoco.mj_step(mj.model, data)
        speeds.append(np.abs(data.qvel[mj.joint_qvel]).mean())
    assert np.mean(speeds[1000:]) < 0.005  # [rad/s]
    assert np.abs(data.site_xpos[list(mj.sole_sites)] - start).max() < 1e-4  # [m]
    assert np.abs(data.site_xpos[list(mj.sole_sites), 2]).max() < 5e-4  # penetration [m]


def test_soles_touch_at_the_corners_of_their_rectangles(robot: RobotModel, mj: MujocoModel) -> None:
    q = robot.standing_configuration()
    q[2] -= 1e-4
    data = placed(robot, mj, q, np.zeros(robot.nv))
    assert data.ncon == 8
    touching = np.array(sorted(tuple(np.round(contact.pos[:2], 6)) for contact in data.contact))
    expected_data = robot.data()
    pin.framesForwardKinematics(robot.pin, expected_data, q)
    expected = [expected_data.oMf[foot.frame_id].act(corner)[:2] for foot in robot.feet for corner in foot.corners]
    np.testing.assert_allclose(touching, np.array(sorted(tuple(np.round(p, 6)) for p in expected)), atol=2e-6)


def test_motors_give_torque_up_to_their_limit(robot: RobotModel, mj: MujocoModel) -> None:
    data = placed(robot, mj, *random_state(robot, 0))
    command = np.linspace(-2.0, 2.0, robot.nj) * robot.tau_max
    np.testing.assert_array_equal(
        mj.model.actuator_ctrlrange[mj.actuator], np.stack([-robot.tau_max, robot.tau_max], 1)
    )
    data.ctrl[mj.actuator] = command
    mujoco.mj_forward(mj.model, data)
    applied = data.qfrc_actuator[mj.joint_qvel]
    np.testing.assert_allclose(applied, np.clip(command, -robot.tau_max, robot.tau_max), atol=1e-9)


def test_joint_friction_comes_from_the_profile(robot: RobotModel, mj: MujocoModel) -> None:
    q, v = random_state(robot, 1)
    data = placed(robot, mj, q, v)
    np.testing.assert_allclose(data.qfrc_passive[mj.joint_qvel], -robot.damping * v[6:], atol=1e-9)
    np.testing.assert_array_equal(mj.model.dof_frictionloss[mj.joint_qvel], robot.frictionloss)
    np.testing.assert_array_equal(data.qfrc_passive[:6], 0.0)


def test_hold_carries_the_robot_until_released(robot: RobotModel, mj: MujocoModel) -> None:
    q = robot.standing_configuration()
    q[:3] += [0.1, -0.2, 0.3]
    q[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3)).coeffs()
    data = placed(robot, mj, q, np.zeros(robot.nv))
    assert data.eq_active[mj.hold_equality] == 0
    mj.hold(data, q[:3], q[3:7])
    for _ in range(1000):
        mujoco.mj_step(mj.model, data)
    held, _ = mujoco_to_pin(robot, mj, data.qpos, data.qvel)
    assert np.linalg.norm(held[:3] - q[:3]) < 0.002
    assert np.linalg.norm(pin.log3(pin.XYZQUATToSE3(held[:7]).rotation.T @ pin.XYZQUATToSE3(q[:7]).rotation)) < 0.01
    mj.release(data)
    for _ in range(200):
        mujoco.mj_step(mj.model, data)
    assert data.qpos[2] < held[2] - 0.1


@pytest.mark.parametrize("velocity", [(0.6, 0.0), (-0.6, 0.0), (0.0, 0.6)])
def test_fallen_robot_lies_on_the_floor(robot: RobotModel, mj: MujocoModel, velocity: tuple[float, float]) -> None:
    v = np.zeros(robot.nv)
    v[:2] = velocity
    data = placed(robot, mj, robot.standing_configuration(), v)
    for _ in range(3000):
        mujoco.mj_step(mj.model, data)
    assert np.isfinite(data.qpos).all()
    com = data.subtree_com[mj.base_body]
    assert 0.03 < com[2] < 0.5
    heights = {name: data.site_xpos[mj.model.site(name).id][2] for name in ("base_link", "torso", "gaze")}
    assert min(heights.values()) > 0.0, heights


def test_friction_and_payload_change_the_plant_only(g1: RobotModel) -> None:
    plain, changed = built(g1), build_mujoco(g1, friction=0.3, payload_kg=4.0)
    assert changed.model.geom("floor").friction[0] == 0.3
    assert plain.model.geom("floor").friction[0] == g1.profile.feet.friction
    assert plain.model.body_mass.sum() == pytest.approx(g1.mass)
    assert changed.model.body_mass.sum() == pytest.approx(g1.mass + 4.0)
    q, v = random_state(g1, 2)
    data = g1.data()
    pin.centerOfMass(g1.pin, data, q)
    torso = g1.pin.frames[g1.frame_id("torso")].parentJoint
    centre = data.oMi[torso].act(g1.pin.inertias[torso].lever)
    np.testing.assert_allclose(placed(g1, changed, q, v).xipos[changed.bodies["payload"]], centre, atol=1e-9)


def test_friction_decides_whether_a_foot_slides(g1: RobotModel) -> None:
    """Gravity tilted by 10 degrees: the feet slip at friction 0.1 and stick at 0.8."""
    moved = {}
    for friction in (0.1, 0.8):
        mj = build_mujoco(g1, friction=friction)
        data = _stand(g1, mj, 0.3)
        start = data.site_xpos[mj.sole_sites[0]].copy()
        mj.model.opt.gravity[1] = GRAVITY * np.tan(np.deg2rad(10.0))
        for _ in range(400):
            error = g1.posture("stand") - data.qpos[mj.joint_qpos]
            data.ctrl[mj.actuator] = 8.0 * g1.kp * error - 2.0 * g1.kd * data.qvel[mj.joint_qvel]
            mujoco.mj_step(mj.model, data)
        moved[friction] = np.linalg.norm((data.site_xpos[mj.sole_sites[0]] - start)[:2])
    assert moved[0.1] > 0.003 > 0.001 > moved[0.8]


def test_bodies_are_known_by_link_and_by_frame(robot: RobotModel, mj: MujocoModel) -> None:
    assert mj.bodies["base_link"] == mj.bodies[robot.profile.base_link] == mj.base_body
    assert mj.bodies["torso"] == mj.model.body(robot.profile.frames["torso"].link).id
    for foot, frame in zip(robot.feet, ("l_sole", "r_sole"), strict=True):
        assert mj.model.body_parentid[mj.bodies[frame]] == mj.bodies[foot.link]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"terrain": "swamp"}, "terrain: unknown 'swamp'; known: flat"),
        ({"friction": 0.0}, "friction"),
        ({"payload_kg": -1.0}, "payload_kg"),
        ({"timestep": 0.0}, "timestep"),
        ({"timestep": float("nan")}, "timestep"),
    ],
)
def test_bad_arguments_are_refused(g1: RobotModel, arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        build_mujoco(g1, **arguments)  # type: ignore[arg-type]


def test_visuals_change_nothing_but_the_picture(robot: RobotModel, mj: MujocoModel) -> None:
    seen = build_mujoco(robot, visuals=True)
    assert seen.model.nmesh > 20 and mj.model.nmesh == 0
    assert seen.model.camera(CAMERA).id >= 0
    q, v = random_state(robot, 4)
    plain, pictured = placed(robot, mj, q, v), placed(robot, seen, q, v)
    np.testing.assert_array_equal(plain.qacc, pictured.qacc)
    visible = np.flatnonzero(seen.model.geom_group != 3)
    floor = seen.model.geom("floor").id
    assert all(seen.model.geom_contype[i] == seen.model.geom_conaffinity[i] == 0 for i in visible if i != floor)


def test_picture_shows_the_robot(robot: RobotModel) -> None:
    mj = build_mujoco(robot, visuals=True)
    data = placed(robot, mj, robot.standing_configuration(), np.zeros(robot.nv))
    try:
        renderer = mujoco.Renderer(mj.model, 120, 160)
    except (ImportError, AttributeError, RuntimeError, mujoco.FatalError) as error:  # no library, device or context
        pytest.skip(f"no OpenGL for off-screen pictures here: {error}")
    renderer.update_scene(data, camera=CAMERA)
    renderer.enable_segmentation_rendering()
    geoms = renderer.render()[..., 0]
    renderer.close()
    robot_pixels = np.count_nonzero((geoms >= 0) & (geoms != mj.model.geom("floor").id))
    assert 0.03 < robot_pixels / geoms.size < 0.6
