"""Acts of ``poise bench hardware_faults``: each injects a fault for the duration of its context."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Any, TypeAlias
from unittest.mock import patch

import numpy as np

from bridge.hardware_loop import HardwareLoop, PlantLoop, Process, Ros2ControlLoop
from bridge.plants.ros2_control.commands import command_codec
from bridge.plants.ros2_control.config import COMMAND, IMU, JOINTS, Source
from bridge.plants.unitree.wire import LOW_CMD, LOW_STATE
from models.types import JointCommand

AnyLoop: TypeAlias = PlantLoop[Any, Any, Any, Any]
Act: TypeAlias = Callable[[Any, float], AbstractContextManager[Any]]

KNEE = 3  #: Motor of the left knee
WRIST = 20  #: Motor of a left wrist joint; it bears no weight
EMPTY_COMMAND = b"\0\1" + bytes(30)  #: Serialised std_msgs/Float64MultiArray without numbers
BOOT_TIME = 0.5  #: Time without states while the robot side restarts [s]


def _at_once(change: Callable[[Any, float], object]) -> Act:
    """Return an act that makes a change at the start of its context, without undoing it."""

    @contextmanager
    def act(loop: AnyLoop, value: float) -> Iterator[None]:
        change(loop, value)
        yield

    return act


def _replaced(part: str, name: str, make: Callable[[AnyLoop, float], Any]) -> Act:
    """Replace an attribute of a part of the loop by ``make(loop, value)``."""
    return lambda loop, value: patch.object(getattr(loop, part), name, make(loop, value))


def _set(name: str) -> Act:
    """Set an attribute of the robot side, or all elements of an array, to the value of the row."""

    def changed(loop: AnyLoop, value: float) -> Any:
        before = getattr(loop.side, name)
        return np.full_like(before, value) if isinstance(before, np.ndarray) else int(value)

    return _replaced("side", name, changed)


def _states(make: Callable[[AnyLoop, float], Callable[[Any], Any]]) -> Act:
    """Change the states on the cable."""
    return _replaced("link", "states_pass", make)


def _damaged(data: bytes) -> bytes:
    return data[:-1] + bytes([data[-1] ^ 0xFF])


def _lost(loop: AnyLoop, probability: float) -> Callable[[bytes], bytes | None]:
    rng = np.random.default_rng(0)
    return lambda data: None if rng.uniform() < probability else data


def _repeated(loop: AnyLoop, value: float) -> Callable[[bytes], bytes]:
    first: list[bytes] = []

    def passed(data: bytes) -> bytes:
        first.append(data)
        return first[0]

    return passed


def _measured(name: str, motor: int, value_of: Callable[[float], float]) -> Act:
    """Report a wrong value for one motor."""

    def make(loop: AnyLoop, value: float) -> Callable[[bytes], bytes]:
        def passed(data: bytes) -> bytes:
            record = LOW_STATE.read(data)
            record["motor_state"][motor][name] = value_of(value)
            return LOW_STATE.write(record)

        return passed

    return _states(make)


@_at_once
def _clock(loop: HardwareLoop, value: float) -> None:
    """Shift the robot's tick by a time [s]."""
    loop.side.clock_offset = round(1000.0 * value)


@_at_once
def _once(loop: HardwareLoop, value: float) -> None:
    """Publish one LowCmd of another program, without torque."""
    record = LOW_CMD.new()
    record["mode_machine"] = loop.side.mode_machine
    loop.link.publish(LOW_CMD.write(record))


def _commander(loop: HardwareLoop, rate: float) -> AbstractContextManager[Any]:
    """Publish commands of another program to the zero posture, with moderate gains, at a rate [Hz]."""
    record = LOW_CMD.new()
    record["mode_machine"] = loop.side.mode_machine
    motors = record["motor_cmd"][: loop.robot.nj]
    motors["mode"], motors["kp"], motors["kd"] = 1, 0.5 * loop.robot.kp, loop.robot.kd
    return _published(loop, LOW_CMD.write(record), rate)


def _published(loop: AnyLoop, data: bytes, rate: float) -> AbstractContextManager[Any]:
    """Publish a command of another program at a rate [Hz]."""
    ticks, step = round(1000.0 / rate), loop.link.step

    def stepped() -> None:
        if loop.side.tick % ticks == 0:
            loop.link.publish(data)
        step()

    return patch.object(loop.link, "step", stepped)


def _command(loop: Ros2ControlLoop) -> bytes:
    """Return a command of another driver of the same kind: zero posture with half the gains, at the present state."""
    zero, q = np.zeros(loop.robot.nj), loop.plant.read().q
    codec = command_codec(loop.robot, loop.plant.config, "poise_driver_0")
    return codec.encode(0, JointCommand(zero, zero, zero, 0.5 * loop.robot.kp, loop.robot.kd), q, zero)


def _silent(loop: AnyLoop, source: str) -> Callable[[Any], Any]:
    return lambda message: None if message[0] == source else message


@_at_once
def _jump(loop: Ros2ControlLoop, value: float) -> None:
    """Shift the robot's stamps by a time [s]."""
    loop.side.stamp_offset = round(1e9 * value)


def _inactive(source: Source) -> Act:
    """Deactivate a controller in the controller manager; without the command controller, torques are zero."""
    return _at_once(lambda loop, value: loop.side.deactivate(source))


@contextmanager
def _pressed(loop: HardwareLoop, button: float) -> Iterator[None]:
    loop.side.press(int(button))
    yield
    loop.side.press()


@_at_once
def _vendor_again(loop: HardwareLoop, value: float) -> None:
    loop.side.vendor = "ai"


def _battery(loop: HardwareLoop, value: float) -> AbstractContextManager[Any]:
    """Restart the robot side after a power loss: no torque, then the vendor's controller, and the tick from zero."""
    side, loop.link.connected = loop.side, False
    side.command, end = None, side.tick + round(1000.0 * BOOT_TIME)
    loop.link.drop()
    step = loop.link.step

    def stepped() -> None:
        if not loop.link.connected and side.tick >= end:
            side.clock_offset, side.vendor, loop.link.connected = -side.tick, "ai", True
        step()

    return patch.object(loop.link, "step", stepped)


def _killed(process: Process) -> Act:
    """Stop a process."""

    @contextmanager
    def act(loop: AnyLoop, value: float) -> Iterator[None]:
        loop.running.discard(process)
        yield
        loop.running.add(process)

    return act


@contextmanager
def _guard_killed(loop: AnyLoop, value: float) -> Iterator[None]:
    """Kill the guard; a new process replaces it at the end."""
    with _killed(Process.GUARD)(loop, value):
        yield
    loop.restart_guard()


def _crashed(vendor: str, *acts: str) -> Act:
    """Restart the driver after a crash, with a controller of the vendor and further faults."""

    @contextmanager
    def act(loop: HardwareLoop, value: float) -> Iterator[None]:
        loop.marker.touch()
        loop.side.vendor = vendor
        loop.restart_driver()
        with ExitStack() as further:
            for name in acts:
                further.enter_context(ACTS[name](loop, value))
            yield

    return act


ACTS: Mapping[str, Act] = {
    "temperature": _set("temperature"),
    "voltage": _set("voltage"),
    "motor_error": _set("motor_error"),
    "mode_machine": _set("mode_machine"),
    "states_damaged": _states(lambda loop, value: _damaged),
    "states_lost": _states(_lost),
    "states_repeated": _states(_repeated),
    "state_nan": _measured("q", KNEE, lambda value: float("nan")),
    "torque_at_limit": _measured("tau_est", WRIST, lambda value: value),
    "commands_damaged": _replaced("link", "commands_pass", lambda loop, value: _damaged),
    "cable": _replaced("link", "connected", lambda loop, value: False),
    "clock": _clock,
    "foreign_once": _once,
    "foreign": _commander,
    "button": _pressed,
    "vendor_again": _vendor_again,
    "never_released": _replaced("link", "release", lambda loop, value: lambda: None),
    "no_answer": _replaced("link", "vendor", lambda loop, value: lambda: None),
    "other_version": _replaced("side", "switcher_version", lambda loop, value: "2.0.0.0"),
    "battery": _battery,
    "source_silent": _states(lambda loop, value: _silent(loop, (JOINTS, IMU)[int(value)])),
    "stamps": _jump,
    "controller_inactive": _inactive(COMMAND),
    "broadcaster_inactive": _inactive(IMU),
    # wrong size: the controller manager deactivates the controller
    "wrong_size": _at_once(lambda loop, value: loop.link.publish(EMPTY_COMMAND)),
    "other_driver": lambda loop, rate: _published(loop, _command(loop), rate),
    "other_driver_once": _at_once(lambda loop, value: loop.link.publish(_command(loop))),
    "driver_killed": _killed(Process.DRIVER),
    "control_killed": _killed(Process.CONTROL),
    "guard_stopped": _killed(Process.GUARD),
    "guard_killed": _guard_killed,
    "crashed_and_rebooted": _crashed("ai"),
    "crashed_no_answer": _crashed("", "no_answer"),
    "crashed_other_robot": _crashed("", "mode_machine"),
}
