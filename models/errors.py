"""The error tree. Errors are raised at construction, never inside the control loop."""

from difflib import get_close_matches
from functools import lru_cache


@lru_cache(maxsize=64)  # refused messages of one stream repeat the same word
def did_you_mean(word: str, known: tuple[str, ...]) -> str:
    """Return ``: did you mean 'NAME'?`` with the nearest known name; empty when none is near."""
    found = get_close_matches(word[:64], known, 1)
    return f": did you mean '{found[0]}'?" if found else ""


class PoiseError(Exception):
    """Base of every error that poise raises on purpose."""


class ConfigError(PoiseError):
    """A YAML file or parameter is unusable; the message names the file and the key."""


class RobotModelError(PoiseError):
    """A URDF or profile is unusable; the message names the file, the joint or link, and the cause."""


class JointNameError(PoiseError):
    """A joint name is missing, unknown or given twice; the message names it."""


class MessageError(PoiseError):
    """A message is malformed (size, NaN, stamp); the message names the field."""


class TrajectoryError(PoiseError):
    """A joint trajectory is refused; the message names the joint or point and the limit."""


class UnreachableError(PoiseError):
    """A motion target cannot be reached; the message names the task and the cause."""


class WorkersError(PoiseError):
    """No worker is available or permitted to measure; the message names the scheduler or the worker."""


class CommandError(PoiseError):
    """A command or mode request is refused; the message says why."""
