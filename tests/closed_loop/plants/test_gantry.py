"""On the gantry of a real robot, in lockstep over the protocol's bytes: other commanders, legs that hang straight."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import pytest

from bridge.driver.start_commands import StartState
from bridge.hardware_loop import HardwareLoop
from bridge.plants.unitree.wire import LOW_CMD
from models.errors import CommandError

OTHER = LOW_CMD.write(LOW_CMD.new())  #: LowCmd of another program, or of the robot's own controller


@contextmanager
def commanded(loop: HardwareLoop, rate: float) -> Iterator[None]:
    """Another program commands at a rate [Hz]."""
    ticks, step = round(1000.0 / rate), loop.link.step

    def stepped() -> None:
        if loop.side.tick % ticks == 0:
            loop.link.publish(OTHER)
        step()

    with patch.object(loop.link, "step", stepped):
        yield


@pytest.mark.long
def test_another_commander_is_found_before_anything_is_released(tmp_path: Path) -> None:
    loop = HardwareLoop(tmp_path / "marker")
    loop.reach(StartState.GANTRY)
    with commanded(loop, 100.0):
        loop.run(0.3)
        assert loop.startup.state is StartState.LISTEN
        for text in (loop.startup.waits_for, *loop.plant.findings):
            assert "lowcmd of another program" in text and "end it" in text and "hardware.own_commands" in text
        with pytest.raises(CommandError, match=r"confirm_gantry refused in state 'listen'.* lowcmd of another program"):
            loop.startup.confirm_gantry()
        loop.run(1.5)
        assert loop.startup.state is StartState.LISTEN
    assert loop.side.vendor == "ai" and not loop.link.sent
    loop.reach(StartState.GANTRY)


@pytest.mark.long
def test_the_known_commands_of_the_robots_own_controller_are_no_other_commander(tmp_path: Path) -> None:
    profile = tmp_path / "own.yaml"
    profile.write_text("extends: g1_hardware\nname: own\nhardware: {own_commands: 500.0}\n", encoding="utf-8")
    loop = HardwareLoop(tmp_path / "marker", laws=profile)
    with commanded(loop, 500.0):
        loop.reach(StartState.GANTRY)
        with commanded(loop, 200.0):
            loop.run(1.5)
            assert loop.startup.state is StartState.LISTEN
        loop.reach(StartState.GANTRY)
        loop.startup.confirm_gantry()
        loop.run(0.3)  # they go on after the release: they are of another program
        assert loop.startup.state is StartState.LISTEN and loop.side.vendor == "" and not loop.link.sent
        waits = loop.startup.waits_for
        assert "lowcmd of another program" in waits and "own_commands" not in waits
        assert "Unitree's controller is released: the robot is limp, or executes what another program" in waits
    loop.reach(StartState.GANTRY)
    loop.startup.confirm_gantry()
    loop.reach(StartState.DAMP)


@pytest.mark.long
def test_legs_that_hang_straight_bear_nothing(tmp_path: Path) -> None:
    """They would bear a force along them almost without torques, so the errors of these are no evidence of one."""
    loop = HardwareLoop(tmp_path / "marker")
    loop.reach(StartState.GANTRY)
    loop.startup.confirm_gantry()
    loop.reach(StartState.HANGING)
    loop.startup.damp("Ctrl-C")
    largest = 0.0
    for _ in range(26):
        loop.run(0.5)
        largest = max(largest, loop.startup.load)
        assert "of the weight" not in loop.startup.grounded
    assert largest > loop.startup.config.hang_load_max
    loop.startup.prepare()
    loop.reach(StartState.HANGING)


@pytest.mark.long
def test_a_robot_that_was_lowered_too_early_stands_on_command(tmp_path: Path) -> None:
    loop = HardwareLoop(tmp_path / "marker")
    loop.reach(StartState.GANTRY)
    loop.startup.confirm_gantry()
    loop.reach(StartState.HANGING)
    loop.side.rope_speed = loop.side.config.lowering_speed
    loop.until(lambda: loop.startup.load > 0.9, 10.0)
    assert "of the weight" in loop.startup.waits_for
    assert loop.startup.lower().startswith("accepted, stand clear: the feet bear")
    loop.reach(StartState.STAND)


@pytest.mark.long
def test_a_robot_that_lies_is_tied_and_wound_up_to_where_it_hung(tmp_path: Path) -> None:
    loop = HardwareLoop(tmp_path / "marker")
    loop.run(0.5)
    height = loop.side.base[2]
    loop.side.hooked = False
    loop.run(2.5)
    assert loop.side.base[2] < 0.4
    loop.side.tie()
    loop.side.rope_speed = -0.25
    loop.run(8.0)
    assert loop.side.slack == 0.0 and abs(loop.side.base[2] - height) < 0.02
    loop.reach(StartState.GANTRY)
    loop.startup.confirm_gantry()
