"""A real robot's driver, protocol and laws against the robot's side in one process, in lockstep: start and stop.

Bytes of LowState and LowCmd pass between them as on the network; only the network is missing.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock, patch

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from msgspec import structs

from bridge.driver.foot_load import identify, payload_profile
from bridge.driver.start_commands import StartState
from bridge.driver.startup import BEFORE_RELEASE
from bridge.hardware_loop import HardwareLoop, Process
from bridge.launch.ending import EndConfig
from bridge.plants.deviation import Deviation
from bridge.plants.hardware import real_robot
from bridge.plants.unitree.codec import BUTTONS, joint_command
from bridge.plants.unitree.wire import LOW_CMD
from controllers.estimation.assembler import mean_sample
from controllers.joints.joint_servo import damping_command, drive_torque
from models.config import default_config
from models.errors import CommandError, MessageError, PoiseError
from models.robot_model import RobotModel
from models.types import Mode, SensorData, Vector
from tests.gantry import started

pytestmark = pytest.mark.long

A_BUTTON, B_BUTTON = 8, 9
AFTERWARDS = (StartState.RELAX, StartState.DAMPED)


@pytest.fixture
def loop(tmp_path: Path) -> HardwareLoop:
    return HardwareLoop(tmp_path / "marker")


@pytest.fixture
def standing(loop: HardwareLoop) -> HardwareLoop:
    return started(loop)


def damping(data: bytes) -> bool:
    """Whether a LowCmd has damping alone; the last torque may still fade."""
    motors = LOW_CMD.read(data)["motor_cmd"][:29]
    return not motors["kp"].any() and not motors["q"].any()


@pytest.mark.parametrize(
    ("rate", "delay"),
    [(500.0, 2), pytest.param(1000.0, 1, marks=pytest.mark.slow), pytest.param(500.0, 8, marks=pytest.mark.slow)],
)
def test_it_starts_from_the_gantry_and_stands(tmp_path: Path, rate: float, delay: int) -> None:
    loop = HardwareLoop(tmp_path / "marker", rate=rate, seed=3, delay=delay)
    loop.start()
    loop.unhook()
    assert loop.history == [str(each) for each in StartState if each not in AFTERWARDS]
    before = loop.side.base
    loop.run(4.0)
    assert np.abs(loop.side.base - before).max() < 0.01
    assert (loop.stack.mode, loop.stack.supervisor.faults, loop.side.refused) == (Mode.STAND, (), 0)
    assert loop.drivers.state == "active"


def test_nothing_is_sent_before_the_release(loop: HardwareLoop) -> None:
    loop.reach(StartState.GANTRY)
    loop.run(2.0)
    assert not loop.link.sent and loop.side.vendor == "ai"
    with pytest.raises(CommandError, match="refused in state 'gantry'"):
        loop.drivers.set_mode(Mode.STAND)
    loop.startup.confirm_gantry()
    loop.run(0.5)
    assert loop.side.vendor == "" and loop.link.sent and all(map(damping, loop.link.sent))


def test_the_stop_button_must_have_been_seen_to_work(loop: HardwareLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    given = replace(real_robot(), remote_unchanged=0.5)
    monkeypatch.setattr("bridge.plants.unitree.plant.real_robot", lambda: given)
    loop.tries_stop_button = False
    loop.run(1.0)
    assert loop.plant.remote_age == np.inf
    loop.side.press(A_BUTTON)
    loop.run(1.5)
    assert loop.startup.state is StartState.LISTEN and "remote controller, B or F1: press it" in loop.startup.waits_for
    assert loop.plant.remote_age == pytest.approx(1.5, abs=0.01) and not loop.plant.warnings
    loop.side.press(B_BUTTON)
    loop.run(0.1)
    assert loop.startup.waits_for == "button B of the remote controller"
    loop.side.press()
    loop.reach(StartState.GANTRY)
    assert not loop.link.sent
    assert loop.plant.warnings == ("remote controller unchanged for more than 0.5 s: check that it is on and in range",)
    loop.side.remote[4] = 1  # a stick
    loop.run(0.1)
    assert not loop.plant.warnings


def test_it_waves_and_walks(standing: HardwareLoop) -> None:
    assert standing.stack.command("wave").accepted
    standing.run(7.0)
    assert standing.stack.mode is Mode.STAND
    begin, estimated = standing.side.base, standing.stack.state.q[:2].copy()
    assert standing.stack.command("walk").accepted
    standing.stack.set_velocity(0.4, 0.0, 0.0)
    standing.run(6.0)
    standing.stack.command("stop")
    standing.run(3.0)
    walked, odometry = standing.side.base - begin, standing.stack.state.q[:2] - estimated
    assert standing.upright and standing.stack.mode is Mode.STAND and not standing.stack.supervisor.faults
    assert walked[0] > 1.8 and np.abs(odometry - walked[:2]).max() < 0.05


def test_the_remote_controller_damps_within_10_ms(standing: HardwareLoop) -> None:
    standing.link.sent.clear()
    standing.side.press(B_BUTTON)
    tick = standing.side.tick
    while not (standing.link.sent and damping(standing.link.sent[-1])):
        standing.step()
    assert standing.side.tick - tick <= 10
    assert standing.startup.state is StartState.DAMPED and "button B" in standing.startup.reason
    assert standing.drivers.state == "damped"
    with pytest.raises(CommandError, match="refused in state 'damped'"):
        standing.drivers.set_mode(Mode.STAND)


@pytest.mark.parametrize("state", [StartState.GANTRY, StartState.PREPARE, StartState.HELD])
def test_each_state_of_the_start_may_be_stopped(loop: HardwareLoop, state: StartState) -> None:
    loop.side.rope_speed = 0.0
    while loop.startup.state is not state:
        if loop.startup.state is StartState.GANTRY:
            loop.startup.confirm_gantry()
        elif loop.startup.state is StartState.HANGING:
            loop.startup.lower()
            loop.side.rope_speed = 0.05
        loop.step()
    loop.side.press(B_BUTTON)
    loop.run(0.05)
    if state in BEFORE_RELEASE:
        assert loop.startup.state is StartState.LISTEN and not loop.link.sent
    else:
        assert loop.startup.state is StartState.DAMPED and damping(loop.link.sent[-1])


def test_a_robot_whose_controller_was_released_before_is_damped_by_the_button(tmp_path: Path) -> None:
    """It is limp, and its own damping is gone."""
    loop = HardwareLoop(tmp_path / "marker", released=True)
    loop.reach(StartState.GANTRY)
    assert not loop.link.sent
    loop.side.press(B_BUTTON)
    loop.run(0.05)
    assert loop.startup.state is StartState.DAMPED and damping(loop.link.sent[-1])


def test_a_lying_robot_is_neither_released_nor_prepared(loop: HardwareLoop) -> None:
    loop.side.hooked = False
    loop.run(3.0)
    with pytest.raises(CommandError, match="confirm_gantry refused: the base is tilted by"):
        loop.startup.confirm_gantry()
    loop.run(0.5)
    assert not loop.link.sent and loop.side.vendor == "ai"


def test_a_robot_that_comes_off_the_rope_is_damped_and_not_prepared_where_it_lies(loop: HardwareLoop) -> None:
    loop.reach(StartState.GANTRY)
    loop.startup.confirm_gantry()
    loop.reach(StartState.PREPARE)
    loop.run(1.0)
    loop.side.hooked = False
    loop.reach(StartState.DAMPED, 1.5)
    assert "of the weight" in loop.startup.reason or "tilted" in loop.startup.reason
    loop.run(3.0)
    with pytest.raises(CommandError, match="prepare refused: the base is tilted by"):
        loop.startup.prepare()


@pytest.mark.parametrize("lowered", [False, True])
def test_a_robot_that_topples_before_it_stands_by_itself_is_damped(loop: HardwareLoop, lowered: bool) -> None:
    loop.reach(StartState.GANTRY)
    loop.startup.confirm_gantry()
    loop.reach(StartState.HANGING)
    if lowered:
        loop.startup.lower()
    loop.side.hooked = False
    loop.run(0.1)
    loop.side.plant.push((250.0, 0.0, 0.0), 0.4)
    loop.run(1.5)
    assert loop.startup.state is StartState.DAMPED and "rad, 0.5 rad at most" in loop.startup.waits_for
    assert damping(loop.link.sent[-1])


def test_no_robot_is_put_on_its_feet_under_a_hold(loop: HardwareLoop) -> None:
    loop.reach(StartState.GANTRY)
    loop.startup.confirm_gantry()
    loop.reach(StartState.HANGING)
    loop.startup.lower()
    loop.side.rope_speed = loop.side.config.lowering_speed
    loop.run(0.5)
    loop.side.temperature[:] = 91.0
    loop.run(6.0)
    assert loop.startup.state is StartState.HELD and loop.startup.load == pytest.approx(1.0, abs=0.1)
    assert "91 degC above 90 degC" in loop.startup.waits_for and loop.stack.mode is Mode.OFF
    loop.side.temperature[:] = 40.0
    loop.reach(StartState.STAND)


@pytest.mark.slow
def test_a_damped_robot_is_hung_up_and_stands_again(standing: HardwareLoop) -> None:
    standing.side.hooked = True
    standing.side.rope_speed = -0.05
    standing.startup.damp("test")
    standing.run(3.0)
    with pytest.raises(CommandError, match=r"prepare refused: the base is tilted .*; hang the robot upright"):
        standing.startup.prepare()  # it has slumped, the rope being slack
    standing.run(7.5)
    standing.startup.prepare()  # it hangs, its legs bent; they reach the floor as they stretch
    with pytest.raises(PoiseError, match=r"damped: the feet bear .* of the weight, 30% at most"):
        standing.reach(StartState.HANGING, 6.0)
    standing.run(6.0)  # its feet are in the air
    standing.side.rope_speed = 0.0
    standing.startup.prepare()
    standing.reach(StartState.HANGING)
    standing.startup.lower()
    standing.side.rope_speed = 0.05
    standing.drivers.set_mode(Mode.OFF)
    standing.stack.supervisor.reset()
    standing.reach(StartState.STAND)
    standing.run(2.0)
    assert standing.upright and standing.stack.mode is Mode.STAND


def test_after_a_crash_the_next_driver_only_damps(standing: HardwareLoop, tmp_path: Path) -> None:
    """The first driver is left without ``close``, as one that was killed; the guard damps until the next one does."""
    assert (tmp_path / "marker").exists()
    standing.running.discard(Process.DRIVER)
    standing.run(0.2)
    assert standing.guard.active
    standing.restart_driver()
    standing.running.add(Process.DRIVER)
    standing.link.sent.clear()
    standing.run(0.08)
    assert standing.plant.crashed and not standing.link.sent and standing.guard.active
    standing.run(1.0)
    assert standing.drivers.state == "damped" and standing.link.sent and all(map(damping, standing.link.sent))
    assert not standing.guard.active
    standing.plant.close()
    assert not (tmp_path / "marker").exists()


def torque(loop: HardwareLoop) -> Vector:
    """That of the newest command on the cable at the present state (nj,) [N.m]."""
    sensors = loop.side.read()
    return drive_torque(
        loop.robot, joint_command(LOW_CMD.read(loop.link.sent[-1]), loop.robot.nj), sensors.q, sensors.v
    )


@pytest.mark.parametrize("state", [StartState.PREPARE, StartState.HELD])
def test_a_driver_that_hung_goes_on_with_damping(loop: HardwareLoop, state: StartState) -> None:
    """The guard has damped meanwhile, and the joints have sunk away from the stiff hold."""
    loop.start(state)
    loop.run(0.05)
    loop.running.discard(Process.DRIVER)
    loop.run(1.5)
    loop.running.add(Process.DRIVER)
    loop.link.sent.clear()
    loop.step()
    assert loop.startup.state is StartState.DAMPED and np.abs(torque(loop)).max() < 10.0


def test_after_a_crash_the_first_press_of_the_stop_button_damps(standing: HardwareLoop) -> None:
    standing.running -= {Process.DRIVER, Process.GUARD}
    standing.run(0.1)
    standing.restart_driver()
    standing.running.add(Process.DRIVER)
    standing.link.sent.clear()
    with patch.object(standing.link, "vendor", lambda: None):  # the motion switcher does not answer
        standing.run(0.2)
        assert not standing.link.sent and "press it" not in standing.startup.waits_for
        standing.side.press(BUTTONS.index("B"))
        standing.run(0.01)
    assert standing.startup.state is StartState.DAMPED and standing.link.sent
    assert "button B" in standing.startup.waits_for


def test_a_guard_that_still_damps_after_a_crash_is_ended_for_the_robots_own_controller(standing: HardwareLoop) -> None:
    standing.running.discard(Process.DRIVER)
    standing.run(0.1)
    assert standing.guard.active
    standing.side.vendor = "ai"  # the robot was started again
    standing.restart_driver()
    standing.running.add(Process.DRIVER)
    standing.link.sent.clear()
    standing.run(2.0)
    assert not standing.guard.armed and not standing.plant.guard.armed and not standing.plant.crashed
    assert 0 < len(standing.link.sent) <= 10 and all(LOW_CMD.read(data)["reserve"][3] for data in standing.link.sent)
    assert standing.startup.state is StartState.GANTRY


def test_a_robot_without_its_guard_is_not_released_and_not_prepared(loop: HardwareLoop) -> None:
    loop.reach(StartState.GANTRY)
    loop.running.discard(Process.GUARD)
    loop.run(0.25)
    assert loop.startup.state is StartState.GANTRY
    loop.run(0.1)
    assert (
        loop.startup.state is StartState.LISTEN and "guard process silent for more than 0.3 s" in loop.startup.waits_for
    )
    assert loop.plant.warnings and not loop.plant.holds
    loop.running.add(Process.GUARD)
    loop.reach(StartState.GANTRY)
    loop.startup.confirm_gantry()
    loop.reach(StartState.HANGING)
    loop.running.discard(Process.GUARD)
    loop.run(1.1)
    assert loop.plant.holds and not loop.plant.warnings and loop.startup.state is StartState.HANGING
    with pytest.raises(CommandError, match="lower refused: guard process silent for more than 1 s"):
        loop.startup.lower()
    loop.startup.damp("test")
    loop.run(0.1)
    with pytest.raises(CommandError, match="prepare refused: guard process silent for more than 1 s"):
        loop.startup.prepare()


@pytest.mark.parametrize("answers", [True, False])
def test_a_crashed_driver_that_has_commanded_nothing_ends_without_a_command(loop: HardwareLoop, answers: bool) -> None:
    """A robot that was started again after the crash stands under its own controller."""
    loop.marker.touch()
    loop.restart_driver()
    if not answers:
        loop.link.vendor = lambda: None  # type: ignore[method-assign]
    loop.run(1.5)
    assert loop.startup.state is (StartState.GANTRY if answers else StartState.LISTEN)
    loop.plant.close()
    assert not loop.link.sent and loop.marker.exists() is not answers


def test_close_damps(standing: HardwareLoop) -> None:
    standing.link.sent.clear()
    standing.plant.close()
    assert all(map(damping, standing.link.sent[80:])) and len(standing.link.sent) == 105
    assert [bool(LOW_CMD.read(data)["reserve"][3]) for data in standing.link.sent] == 100 * [False] + 5 * [True]
    standing.running.discard(Process.DRIVER)
    standing.run(0.1)
    assert not standing.guard.armed and len(standing.link.sent) == 105  # the robot's own controller may take over
    motors = LOW_CMD.read(standing.link.sent[-1])["motor_cmd"][:29]
    assert motors["kd"].min() > 0.0 and not motors["tau"].any()
    assert "configure it again" in standing.plant.findings[0]


def test_a_run_that_cannot_be_marked_is_commanded_with_a_warning(
    loop: HardwareLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop.run(0.5)
    monkeypatch.setattr("bridge.plants.hardware.FileIO", Mock(side_effect=OSError("no space left")))
    loop.plant.write(damping_command(loop.robot))
    assert loop.link.sent and "no space left" in loop.plant.warnings[-1]


def test_close_after_a_hang_goes_on_with_the_damping_of_the_guard(
    loop: HardwareLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = SimpleNamespace(monotonic=lambda: loop.t, sleep=lambda _: None)
    monkeypatch.setattr("bridge.plants.hardware.time", clock)
    loop.start(StartState.PREPARE)
    loop.run(0.2)
    loop.running.discard(Process.DRIVER)
    loop.run(1.5)
    loop.link.sent.clear()
    loop.plant.close()
    assert all(map(damping, loop.link.sent)) and not LOW_CMD.read(loop.link.sent[0])["motor_cmd"]["tau"].any()


def speeds(loop: HardwareLoop, time: float) -> tuple[float, float]:
    """Largest speeds of pelvis and torso in a time [s]: [m/s]."""
    plant, largest = loop.side.plant, np.zeros(2)
    for _ in range(round(time / loop.plant.period)):
        loop.step()
        for i, body in enumerate(("base_link", "torso")):
            velocity = np.zeros(6)
            mujoco.mj_objectVelocity(
                plant.model, plant.data, mujoco.mjtObj.mjOBJ_BODY, plant.mujoco.bodies[body], velocity, 0
            )
            largest[i] = max(largest[i], np.linalg.norm(velocity[3:]))
    return float(largest[0]), float(largest[1])


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_a_lowered_robot_sinks_slowly(tmp_path: Path, seed: int) -> None:
    """One that is damped where it stands reaches 1.6 m/s at the pelvis and 2.7 m/s at the torso."""
    loop = started(HardwareLoop(tmp_path / "marker", seed=seed))
    ending = default_config(EndConfig, "bridge", "ending")
    loop.command(ending.motion)
    down = speeds(loop, 5.0)
    assert (loop.stack.mode, loop.startup.state) == (Mode.STAND, StartState.STAND) and loop.side.base[2] < 0.42
    assert max(down) < 0.4
    loop.drivers.relax()
    sinking = speeds(loop, loop.startup.config.relax_time + ending.sink_time)
    assert sinking[0] < 1.0 and sinking[1] < 1.6
    assert loop.startup.state is StartState.DAMPED and "lowered" in loop.startup.reason
    assert loop.side.base[2] < 0.2 and damping(loop.link.sent[-1])


def test_only_a_robot_that_has_crouched_may_relax(standing: HardwareLoop) -> None:
    def refuses(reason: str) -> bool:
        with pytest.raises(CommandError, match=reason):
            standing.drivers.relax()
        return standing.startup.state is StartState.STAND

    assert refuses("standing height, below 75 % is required: send crouch first, or request damp")
    standing.command("walk")
    standing.run(0.1)
    assert refuses("mode 'walk': send stop, then crouch, or request damp")
    standing.command("stop")
    standing.until(lambda: standing.stack.mode is Mode.STAND, 3.0)
    standing.command("crouch")
    standing.run(3.5)
    assert refuses("mode 'motion'")
    standing.run(1.5)
    standing.drivers.relax()


@pytest.mark.parametrize(
    ("stop", "reason"),
    [
        (lambda loop: loop.side.press(B_BUTTON), "button B"),
        pytest.param(lambda loop: loop.drivers.set_mode(Mode.DAMP), "mode damp was requested"),
    ],
    ids=["remote controller", "mode"],
)
def test_a_relaxing_robot_is_damped_at_once(
    standing: HardwareLoop, stop: Callable[[HardwareLoop], None], reason: str
) -> None:
    standing.startup.relax()
    standing.run(0.1)
    assert standing.drivers.state == "relaxing" and not damping(standing.link.sent[-1])
    stop(standing)
    standing.run(0.2)
    assert reason in standing.startup.reason and damping(standing.link.sent[-1])


def drift(loop: HardwareLoop) -> float:
    """Way of the base in the 5 s after the rope is untied [m]."""
    loop.start()
    loop.unhook()
    begin = loop.side.base
    loop.run(5.0)
    assert not loop.failure
    return float(np.linalg.norm((loop.side.base - begin)[:2]))


@pytest.mark.parametrize(
    ("deviation", "mass", "forward"),
    [
        (Deviation(torso_mass=1.8), 1.8, 0.0),
        pytest.param(Deviation(com=(0.02, 0.0, 0.0)), 0.0, 0.02, marks=pytest.mark.slow),
        pytest.param(Deviation(com=(-0.02, 0.0, 0.0)), 0.0, -0.02, marks=pytest.mark.slow),
    ],
)
def test_mass_and_com_are_identified_from_standing_still_and_used(
    tmp_path: Path, deviation: Deviation, mass: float, forward: float
) -> None:
    loop = HardwareLoop(tmp_path / "marker", seed=4, deviation=deviation)
    drift(loop)
    samples = []
    for _ in range(500):
        loop.step()
        samples.append(loop.drivers.read())
    mean = mean_sample(samples)
    found = identify(loop.robot, mean)
    assert found.mass == pytest.approx(mass, abs=0.3)
    np.testing.assert_allclose(found.com, (forward, 0.0), atol=0.003)
    with pytest.raises(MessageError, match="the robot must stand still"):
        identify(loop.robot, structs.replace(mean, v=np.ones(loop.robot.nj)))
    with pytest.raises(MessageError, match="of the weight on the feet"):
        identify(loop.robot, structs.replace(mean, tau=gravity_torques(loop.robot, mean)))
    if not mass:
        profile = tmp_path / "robot.yaml"
        profile.write_text(payload_profile("g1_hardware", "g1_hardware", found), encoding="utf-8")
        assert drift(HardwareLoop(tmp_path / "marker_2", laws=profile, seed=4, deviation=deviation)) < 0.01


def gravity_torques(model: RobotModel, sensors: SensorData) -> Vector:
    """Of a robot that hangs upright by its base (nj,) [N.m]."""
    q = pin.neutral(model.pin)
    q[7:] = sensors.q
    return np.array(pin.computeGeneralizedGravity(model.pin, model.data(), q)[6:])
