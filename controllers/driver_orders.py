"""What motor drivers accept of who commands them: modes, and commands by the stamp of the sensors they answer."""

from __future__ import annotations

from collections import Counter

from controllers.joint_servo import JointServo, ServoState
from controllers.supervisor import ACTIVE_MODES
from models.errors import CommandError, MessageError
from models.types import Mode

TOO_OLD = "commands too old"
"""Key of the counter of commands that answer sensors too old."""


def follow_mode(servo: JointServo, before: Mode, mode: Mode) -> None:
    """Arm, damp or switch off the drivers of a robot that nobody holds, as the supervisor's mode says.

    Args:
        servo: The drivers.
        before: The mode up to now; drivers that have damped by themselves are armed by a new one to move in only.
        mode: The mode from now on.

    Raises:
        CommandError: Off, while the drivers are active: the robot would drop.
    """
    if mode is Mode.OFF and servo.state is ServoState.ACTIVE:
        raise CommandError("mode 'off' refused: the robot would drop; 'damp' comes first")
    if mode in ACTIVE_MODES:
        if before not in ACTIVE_MODES:
            servo.arm()
    elif mode is Mode.DAMP:
        servo.damp()
    else:
        servo.off()


def check_stamp(stamp: int, last: int, now: int, max_age: int, counters: Counter[str]) -> None:
    """Judge the stamp of a command; all times in [ns].

    Args:
        stamp: Of the sensors that the command answers; 0 means now.
        last: Of the last command in force.
        now: Of the newest sensors.
        max_age: Age of the sensors above which the command is refused.
        counters: Counts the commands that are too old.

    Raises:
        MessageError: The stamp is not newer than the last command's, not yet due, or too old.
    """
    if stamp and not last < stamp <= now:
        raise MessageError(f"header.stamp: {stamp} ns is not after {last} ns or not yet due")
    if stamp and now - stamp > max_age:
        counters[TOO_OLD] += 1
        raise MessageError(f"header.stamp: {stamp} ns is {now - stamp} ns old, more than {max_age} ns")
