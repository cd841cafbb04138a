"""Lockstep faults at the hardware boundary: protocol, robot, network and processes, and the reaction to each.

States and commands are the bytes of Unitree's protocol or of ros2_control; the robot behind them is simulated.
"""

from contextlib import AbstractContextManager, ExitStack
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal
from unittest.mock import patch

import numpy as np
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import settings
from benchmarks.core.fault_rows import AnyRow, FaultBenchmark
from benchmarks.core.harness import Case, Options, chosen
from benchmarks.faults.hardware_acts import ACTS, AnyLoop
from bridge.driver.start_commands import StartState
from bridge.hardware_loop import HardwareLoop, Ros2ControlLoop
from bridge.plants.ros2_control.commands import DRIVER, GUARD
from bridge.plants.unitree.codec import GUARD_MARK, MARK
from bridge.plants.unitree.wire import LOW_CMD
from controllers.joints.joint_servo import drive_torque
from models.config import STRICT, NonNegative, Positive
from models.errors import PoiseError
from models.types import JointCommand, Mode, Vector


@schema(frozen=True, slots=True, kw_only=True, config=STRICT)
class Row(AnyRow):
    """Hardware fault; ``act`` is in ``benchmarks/faults/hardware_acts.py``.

    ``plant`` is the interface of the robot, ``expect`` the required reaction. With ``start`` the fault exists before
    the robot starts; the start must be refused or succeed. ``at`` is the start state at which the fault is injected.
    """

    plant: Literal["unitree", "ros2_control"] = "unitree"
    expect: Literal["goes on", "holds", "damps", "refuses"]
    start: bool = False
    at: StartState = StartState.STAND
    value: float = 0.0  #: Value of the act, in its unit
    time: Positive | None = None  #: Time after which the fault ends [s]; it persists when None


@schema(frozen=True, slots=True, config=STRICT)
class HardwareFaultsConfig:
    """All rows; the units are in ``benchmarks/config/hardware_faults.yaml``."""

    laws: str
    rate: Positive
    delay: int
    settle: NonNegative
    duration: Positive
    forward: Positive
    torque_step_limit: Positive
    rows: dict[str, Row]


config = partial(settings, HardwareFaultsConfig, "hardware_faults")


class CommandSteps:
    """Torque steps caused by commands of driver and guard, from the laws of consecutive commands.

    Both laws are evaluated at the true state when the later command takes effect, within the limits of the drives.
    ``largest`` is relative to the drive's rate limit over one period, independent of the time between the commands;
    ``torque`` is the same step [N.m]. A switch to or from a command of another program does not count.
    """

    def __init__(self, loop: AnyLoop) -> None:
        self.largest = self.torque = 0.0
        self._side, self._model = loop.side, loop.side.model
        self._limit = loop.side.model.tau_rate_max * loop.plant.period
        self._own = loop.side.received > 0
        self._mark = loop.plant.mark if isinstance(loop, Ros2ControlLoop) else None
        self._receive = loop.side.receive

    def watch(self) -> AbstractContextManager[Any]:
        """Compare the commands that the robot receives within the context."""
        return patch.object(self._side, "receive", self._on_command)

    def _on_command(self, data: bytes) -> None:
        before, accepted = self._side.drive(), self._side.received
        self._receive(data)
        if self._side.received == accepted:
            return
        own = self._is_own(data)
        if own and self._own:
            step = np.abs(self._torque(self._side.drive()) - self._torque(before))
            shares = step / self._limit
            worst = int(shares.argmax())
            if shares[worst] > self.largest:
                self.largest, self.torque = float(shares[worst]), float(step[worst])
        self._own = own

    def _is_own(self, data: bytes) -> bool:
        """Whether a command is from the driver or the guard."""
        if self._mark is None:
            return int(LOW_CMD.read(data)["reserve"][0]) in (MARK, GUARD_MARK)
        mark: str = self._mark(data)
        return mark == GUARD or (mark.startswith(DRIVER) and mark != f"{DRIVER}_0")

    def _torque(self, command: JointCommand) -> Vector:
        plant = self._side.plant
        q, v = plant.data.qpos[plant.mujoco.joint_qpos], plant.data.qvel[plant.mujoco.joint_qvel]
        return np.clip(drive_torque(self._model, command, q, v), -self._model.tau_max, self._model.tau_max)


class Trial:
    """One row on a robot that stands without rope, or that has stopped in another state of its start."""

    def __init__(self, loop: AnyLoop, row: Row) -> None:
        self._loop, self._row = loop, row
        self._reacted: float | None = None  # time after the injection [s]
        self._why = ""  # reason of the driver at that time

    def run(self) -> Case:
        """Inject, observe, judge: ``ok``, ``seen``, ``reason``, ``time`` to the reaction [s], torque steps."""
        loop, row = self._loop, self._row
        if row.walk:
            loop.command("walk")
            loop.stack.set_velocity(config().forward, 0.0, 0.0)
        loop.run(config().settle)
        steps, begin = CommandSteps(loop), loop.t
        with ExitStack() as fault:
            fault.enter_context(steps.watch())
            active = fault.enter_context(ExitStack())
            active.enter_context(ACTS[row.act](loop, row.value))
            for _ in range(round((row.duration or config().duration) / loop.plant.period)):
                if row.time is not None and loop.t - begin >= row.time:
                    active.close()
                loop.step()
                if self._reacted is None and self._reaction:
                    self._reacted, self._why = loop.t - begin, loop.startup.reason
            outcome = self._outcome()
        return outcome | {"torque_step": steps.largest, "torque_step_nm": steps.torque}

    @property
    def _reaction(self) -> bool:
        """Whether the expected reaction has occurred."""
        loop = self._loop
        if self._row.expect == "damps":
            return loop.startup.state is StartState.DAMPED or loop.guard.active
        return self._row.expect == "holds" and bool(loop.plant.holds)

    def _outcome(self) -> Case:
        loop, row = self._loop, self._row
        up = loop.upright and not loop.monitor.fallen
        damped = loop.startup.state not in (row.at, StartState.STAND) or loop.guard.active
        reasons = [*loop.plant.holds, self._why, loop.startup.reason, *loop.stack.supervisor.faults]
        ok = damped if row.expect == "damps" else up and not damped and loop.startup.state is StartState.STAND
        if row.expect == "holds":
            reply = loop.stack.command("walk")
            ok = ok and not reply.accepted and loop.stack.gait.settled
            reasons.append(reply.reason)
        elif row.expect == "goes on":
            ok = ok and not loop.plant.holds
        if row.expect != "damps":
            ok = ok and loop.stack.mode is (Mode.WALK if row.walk and row.expect == "goes on" else Mode.STAND)
        reason = "; ".join(dict.fromkeys(filter(None, reasons)))
        on_time = row.within is None or (self._reacted is not None and self._reacted <= row.within)
        seen = f"start '{loop.startup.state}'"
        if loop.guard.active:
            seen = "guard commands"
        elif loop.startup.state is StartState.STAND:
            seen = f"mode '{loop.stack.mode.value}'"
        return {
            "seen": f"{'up' if up else 'down'}, {seen}",
            "up": up,
            "reason": reason[:200],
            "time": self._reacted,
            "ok": ok and row.reason in reason and on_time,
        }


def at_start(loop: AnyLoop, row: Row) -> Case:
    """Start a robot with a fault that exists from the beginning.

    Either the start fails with a reason before any command, or it succeeds without a command before the confirmation.
    """
    sent, steps = loop.link.sent, CommandSteps(loop)
    with ACTS[row.act](loop, row.value), steps.watch():
        try:
            loop.reach(StartState.GANTRY)
            early = len(sent)
            loop.start()
            reason = ""
        except PoiseError as error:
            reason, early = str(error), len(sent)
    ok = not early and (bool(reason) and row.reason in reason if row.expect == "refuses" else not reason)
    seen = f"start '{loop.startup.state}', {early} commands sent before"
    return {"seen": seen, "up": False, "reason": reason[:200], "time": None, "torque_step": steps.largest, "ok": ok}


def measure(robot: str, seed: int, row: str) -> Case:
    """Start a robot and run one row."""
    given = config()
    asked = given.rows[row]
    with TemporaryDirectory(prefix="poise_faults_") as folder:
        loop: AnyLoop
        options: dict[str, Any] = {"laws": given.laws, "seed": seed, "delay": given.delay, "robot": robot}
        if asked.plant == "unitree":
            loop = HardwareLoop(Path(folder) / "marker", rate=given.rate, **options)
        else:
            loop = Ros2ControlLoop(Path(folder) / "marker", **options)
        if asked.start:
            outcome = at_start(loop, asked)
        else:
            loop.start(asked.at)
            if asked.at is StartState.STAND:
                loop.unhook()
            outcome = Trial(loop, asked).run()
    if not outcome["torque_step"] <= given.torque_step_limit:
        outcome["ok"] = False
    return {"group": asked.group, "expected": asked.expect, "within": asked.within, **outcome}


class HardwareFaults(FaultBenchmark):
    """All rows, or the selected ones, for every seed."""

    measure = staticmethod(measure)

    def cases(self, options: Options) -> list[Case]:
        rows = chosen("hardware_faults", options.scenarios, list(config().rows))
        return [{"robot": options.robot, "seed": seed, "row": row} for row in rows for seed in options.each_seed()]
