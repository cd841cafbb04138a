"""Torques of the start: the stiff hold, its bound, its load and its fades."""

import numpy as np
import pinocchio as pin
import pytest
from msgspec import structs

from bridge.driver.start_commands import StartState
from bridge.driver.startup import StartInputs, Startup
from bridge.plants.base import standing_torques
from controllers.joints.joint_servo import drive_torque
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData
from tests.start_bench import DT, Bench


def test_a_relaxing_robot_fades_from_the_last_command_with_its_gains_to_damping(bench: Bench) -> None:
    bench.reach(StartState.STAND)
    bench.run(1.0)
    startup, v = bench.startup, 0.1 * np.ones(bench.model.nj)
    startup.relax()
    torques = []
    while startup.state is StartState.RELAX:
        command = bench.tick(v)
        assert command is not None
        torques.append(drive_torque(bench.model, command, bench.q - 0.1, v))
        assert startup.state is not StartState.RELAX or startup.waits_for.startswith("the robot to sink, ")
    assert len(torques) == pytest.approx(startup.config.relax_time / DT, abs=2)
    first = drive_torque(bench.model, bench.driver, bench.q - 0.1, v)
    np.testing.assert_allclose(torques[0], first, rtol=0.01)
    np.testing.assert_allclose(torques[len(torques) // 2], 0.5 * (first - bench.model.kd * v), rtol=0.02)
    assert startup.state is StartState.DAMPED and "lowered" in startup.waits_for


def test_in_the_air_the_stiff_hold_uses_half_of_the_torque_and_gives_way_to_what_holds_a_joint(bench: Bench) -> None:
    bench.reach(StartState.HANGING)
    away = bench.q.copy()
    away[3] -= 0.5
    for held, damped in ((0.5, False), (0.7, True)):
        away[3] = bench.q[3] - held
        sensors = structs.replace(bench.sensors(), q=away)
        command = bench.startup.command(sensors, bench.driver)
        assert command is not None
        torque = drive_torque(bench.model, command, away, np.zeros(bench.model.nj))
        assert torque[3] == pytest.approx(0.5 * bench.model.tau_max[3])
        assert command.kd is not None and command.kd.min() > 0.0  # also of the one at the bound
        bench.startup.update(StartInputs(sensors, vendor=""))
        assert (bench.startup.state is StartState.DAMPED) == damped


def test_the_bound_in_the_air_is_of_the_torque_that_reduced_gains_give(g1: RobotModel) -> None:
    def executed(command: JointCommand) -> JointCommand:
        assert command.kp is not None and command.kd is not None
        return structs.replace(command, kp=np.minimum(command.kp, g1.kp), kd=np.minimum(command.kd, g1.kd))

    bench = Bench(g1, executed=executed)
    bench.reach(StartState.HANGING)
    q, v = bench.q - 0.3 * g1.tau_max / g1.kp, np.zeros(g1.nj)  # four times that with the gains of the stiff hold
    command = bench.startup.command(structs.replace(bench.sensors(), q=q), bench.driver)
    assert command is not None
    np.testing.assert_allclose(drive_torque(g1, executed(command), q, v), 0.3 * g1.tau_max)


def test_the_ramp_is_slow_and_ends_in_the_standing_posture(bench: Bench) -> None:
    bench.q = bench.model.posture("stand") + 1.2
    bench.reach(StartState.DAMP)
    bench.run(1.1)
    assert bench.startup.state is StartState.PREPARE
    positions = []
    while bench.startup.state is StartState.PREPARE:
        bench.tick()
        positions.append(bench.q)
    assert np.abs(np.diff(positions, axis=0)).max() / DT < 1.6 * bench.startup.config.ramp_speed
    assert np.allclose(bench.q, bench.model.posture("stand"), atol=1e-6)


def test_gains_fade_without_a_step_of_torque(bench: Bench) -> None:
    bench.reach(StartState.LOADED)
    q, v = bench.model.posture("stand") + 0.02, np.full(bench.model.nj, 0.1)
    bench.q = q
    before = bench.startup.command(bench.sensors(v), bench.driver)
    assert before is not None
    torques = [drive_torque(bench.model, before, q, v)]
    bench.inputs["driven"] = True
    for _ in range(300):
        bench.t += DT
        bench.q = q
        bench.startup.update(StartInputs(bench.sensors(v), vendor="", load=1.0, driven=True))
        command = bench.startup.command(bench.sensors(v), bench.driver)
        assert command is not None
        torques.append(drive_torque(bench.model, command, q, v))
    end = drive_torque(bench.model, bench.driver, q, v)
    assert np.allclose(torques[-1], end) and not bench.startup.fading
    step = np.abs(np.diff(torques, axis=0)).max(axis=0)
    assert (step <= 1.6 * np.abs(end - torques[0]) * DT / bench.startup.config.fade + 1e-9).all()


def test_after_a_stop_the_last_torque_fades(bench: Bench) -> None:
    bench.reach(StartState.STAND)
    bench.run(1.0)
    held = bench.startup.command(bench.sensors(), bench.driver)
    assert held is not None
    last = drive_torque(bench.model, held, bench.q, np.zeros(bench.model.nj))
    bench.startup.damp("test")
    first = bench.startup.command(bench.sensors(), bench.driver)
    assert first is not None and np.allclose(first.tau, last)
    bench.run(0.16)
    end = bench.startup.command(bench.sensors(), bench.driver)
    assert end is not None and not end.tau.any()


def test_the_torque_that_a_killed_driver_left_fades_from_the_first_command_on(g1: RobotModel) -> None:
    startup, three, zero = Startup(g1, crashed=True), np.zeros(3), np.zeros(g1.nj)

    def torque(t: float, tau: float, stale: float) -> float | None:
        sensors = SensorData(t, zero, zero, np.full(g1.nj, tau), three, three, np.full((2, 6), np.nan))
        startup.update(StartInputs(sensors, vendor="", stale=stale))
        command = startup.command(sensors, JointCommand.torque(zero))
        return None if command is None else float(command.tau[0])

    for stale in (0.1, 0.5):
        assert torque(0.0, np.nan, stale) is None  # before the first sample
    t, ramp = DT, 0.15
    while (first := torque(t, 5.0, 0.0)) is None:
        t += DT
    assert first == 5.0 and t == pytest.approx(startup.config.quiet_time, abs=2 * DT)
    assert torque(t, 5.0, 0.1) == pytest.approx(5.0 * (1.0 - 0.1 / ramp))  # without samples
    assert torque(t, 5.0, 0.2) == 0.0


def test_the_torques_of_the_load_hold_the_weight(g1: RobotModel) -> None:
    """Virtual work: for a motion with both soles flat on the floor, tau' dq = m g dz of the CoM."""
    data = g1.data()
    joints = g1.posture("stand").copy()
    motion = np.zeros(g1.nj)
    for side in ("left", "right"):
        for joint, share in (("hip_pitch", -1.0), ("knee", 2.0), ("ankle_pitch", -1.0)):
            motion[g1.joint_index(f"{side}_{joint}_joint")] = share
    motion[g1.joint_index("waist_pitch_joint")] = 0.5

    def height(step: float) -> float:
        return float(pin.centerOfMass(g1.pin, data, g1.planted(joints + step * motion, data))[2])

    torques = standing_torques(g1, joints, data)
    work = GRAVITY * g1.mass * (height(1e-5) - height(-1e-5)) / 2e-5
    assert torques @ motion == pytest.approx(work, rel=1e-4) and abs(work) > 10.0


def test_the_stiff_hold_includes_them_by_the_share_of_the_load(bench: Bench) -> None:
    bench.reach(StartState.HANGING)
    bench.inputs.update(load=1.0)
    command = bench.tick()
    assert command is not None and not command.tau.any()
    bench.inputs.update(load=0.5)
    bench.startup.lower()
    bench.run(2.0)
    command = bench.tick()
    assert command is not None
    expected = standing_torques(bench.model, bench.q, bench.model.data())
    np.testing.assert_allclose(command.tau, 0.5 * expected, rtol=1e-3)
