"""Mode machine of the robot: mode requests, text commands, velocities, faults and refusals with their reason.

The law:

    off, damp -> stand <-> motion          stand <-> walk with a gait planner; some motions while walking

    fault of severity hold                 walk -> stand, and no velocity and no new motion, while the cause lasts
                      stand                walk, motion -> stand, latched until the robot stands without the cause, or
                                           ``reset_faults``
                      damp                 any but off -> damp, latched until ``reset_faults``
    emergency stop                         any -> damp, latched likewise

Arming requires preflight checks that passed after the robot was last active, because it may have been moved since.

The class has no clock and no I/O: time is an argument of ``update``. The node publishes ``mode``, sends the names from
``take_motion`` to the motion planner, and answers services with the ``CommandReply`` of this class.
"""

import re

from controllers.safety.health import Health, Severity, SupervisorConfig
from models.config import default_config
from models.errors import did_you_mean
from models.robot_model import RobotModel
from models.status import GET_UP
from models.types import CommandReply, Mode, Velocity

#: Text commands that need a gait planner; refused with the reason without one
GAIT_WORDS = ("walk", "forward", "backward", "left", "right", "turn", "spin")
_SENTENCE = re.compile(r"[\w ,.!?]+")  #: Text that may contain a command among other words
#: Modes in which the whole-body controller moves the joints
ACTIVE_MODES = (Mode.STAND, Mode.WALK, Mode.MOTION)
_EMERGENCY_STOP = "emergency stop"


class Supervisor:
    """Guarded mode transitions, text commands and the fault latch.

    ``gait`` is whether a gait planner exists; without one a walk ends, and requests to walk are refused. ``faults`` are
    the reasons of the latched faults, ``holds`` those of the present faults of severity hold. ``motion`` is the name of
    the requested or running motion. ``ignored`` counts ignored text commands. The caller sets ``fallen`` while the
    robot lies on the ground, which forbids standing, and ``held`` while the drivers hold it at its start, which forbids
    walking.
    """

    def __init__(self, model: RobotModel, config: SupervisorConfig | None = None, *, gait: bool = False) -> None:
        self.model = model
        self.gait = gait
        self.config = default_config(SupervisorConfig, "controllers", "supervisor") if config is None else config
        self.ignored = 0
        self.fallen = self.held = False
        self.reset()

    def reset(self, mode: Mode = Mode.OFF, *, stopped: bool = False) -> None:
        """Clear faults, findings and pending motions and start in ``mode``; ``stopped`` keeps an emergency stop."""
        self.mode = mode
        self.faults: tuple[str, ...] = (_EMERGENCY_STOP,) if stopped else ()
        self.holds: tuple[str, ...] = ()
        self._passing: set[str] = set()  # faults that clear with their cause
        self.motion: str | None = None
        #: Findings of the last preflight check; empty when it passed
        self.preflight: tuple[str, ...] = ("preflight checks have not run yet",)
        self._pending: str | None = None
        self._velocity: Velocity | None = None
        self._halting = self._by_velocity = False
        self._barred = mode is not Mode.OFF  # a velocity that continues after a stop starts no walk
        self._released: set[str] = set()  # sources whose velocity has been zero, or has paused, since
        self._motion_seen = False
        self._motion_since: float | None = None

    @property
    def still(self) -> bool:
        """Whether velocities are ignored: a walk is ending, or a fault of severity hold is present."""
        return self._halting or bool(self.holds)

    def set_preflight(self, findings: tuple[str, ...]) -> None:
        """Store the findings of ``controllers.safety.preflight``; arming is refused until they are empty."""
        self.preflight = findings

    def request(self, mode: Mode) -> CommandReply:
        """Request a mode; the reply has the reason of a refusal. ``off`` may change to ``stand`` directly."""
        if mode is self.mode and not self._halting:
            self._by_velocity = False
            return CommandReply(True, f"already in mode '{mode.value}'")
        if mode is Mode.DAMP:
            return self._enter(Mode.DAMP, "joints are damped")
        if mode is Mode.OFF:
            if self.mode in ACTIVE_MODES:
                return self._refuse(mode, "the robot would drop; request 'damp' first")
            return self._enter(Mode.OFF, "drivers are off")
        if mode is Mode.WALK:
            return self._walk()
        if mode is Mode.MOTION:
            return self._refuse(mode, f"send the name of a motion instead: {', '.join(self.config.motions)}")
        if self.mode in (Mode.MOTION, Mode.WALK):
            return self._stop()
        if self._lame:
            return self._refuse(mode, self._lame)
        return self._enter(Mode.STAND, "standing")

    @property
    def _lame(self) -> str:
        """Reason why the robot cannot stand; empty if it can."""
        if self.fallen:
            return "; ".join(("the robot has fallen", GET_UP, *self.faults, *self.preflight))
        if self.faults:
            return f"latched faults: {'; '.join(self.faults)}; call reset_faults first"
        return f"preflight: {'; '.join(self.preflight)}" if self.preflight else ""

    @property
    def _to_stand(self) -> str:
        """Hint for a request that needs an active robot."""
        return "request 'stand' first" + (f", which is refused: {self._lame}" if self._lame else "")

    def text(self, command: str) -> CommandReply:
        """Execute a text command such as ``"wave"`` or ``"Please wave."``, or reply with the reason of the refusal."""
        if len(command) > self.config.text_length_max:
            self.ignored += 1
            return CommandReply(
                False, f"command of {len(command)} characters ignored: limit is {self.config.text_length_max}"
            )
        word = self._word_of(command.strip().lower())
        if word == "stop":
            return self._stop()
        if word == "stand":
            return self.request(Mode.STAND) if self.mode is not Mode.STAND else self._start_motion("stand")
        if word in self.config.motions:
            return self._start_motion(word)
        if word in GAIT_WORDS:
            return self._gait_word(word)
        self.ignored += 1
        near = did_you_mean(word, self._known)
        return CommandReply(
            False, f"unknown command {word[:32]!r} ignored{near or ';'} known: {', '.join(self._known)}"
        )

    @property
    def _known(self) -> tuple[str, ...]:
        return *self.config.motions, "stand", "stop", *GAIT_WORDS

    def _word_of(self, text: str) -> str:
        """The command in a sentence; the text itself without a command, with several, or with unknown words."""
        words = set(re.findall(r"\w+", text))
        if "stop" in words:
            return "stop"
        others = words.difference(self._known, self.config.filler_words)
        found = words.intersection(self._known)
        found = found - {"walk"} or found  # "walk forward" is forward
        return found.pop() if len(found) == 1 and not others and _SENTENCE.fullmatch(text) else text

    def barred(self, source: str, *, fresh: bool) -> bool:
        """Whether a velocity continues from before a stop; a ``fresh`` one (zero, or after a pause) does not."""
        if fresh:
            self._released.add(source)
        return self._barred and source not in self._released

    def drive(self, moving: bool, *, fresh: bool, source: str = "") -> CommandReply:
        """Accept a velocity of a source in mode ``walk``, or start a walk in mode ``stand``.

        ``moving`` is whether the velocity is nonzero. A ``barred`` velocity neither starts nor continues a walk.
        """
        barred = self.barred(source, fresh=fresh)
        if self.mode is Mode.WALK and (self.still if barred else not moving or not self.still):
            return CommandReply(True, "velocity accepted")
        if self.mode not in (Mode.STAND, Mode.WALK):
            return self._refuse(Mode.WALK, "send 'stop' first" if self.mode is Mode.MOTION else self._to_stand)
        if not self.config.walk_on_velocity and self.mode is Mode.STAND:
            return self._refuse(Mode.WALK, "request mode/walk first")
        if not moving:
            return CommandReply(True, "zero velocity: standing")
        if barred:
            return self._refuse(
                Mode.WALK, "the robot was stopped; send a zero velocity, or pause, before a new velocity"
            )
        reply = self._walk()
        self._by_velocity |= reply.accepted
        return reply

    def rest(self) -> None:
        """End a walk that a velocity started; called when the robot stands still at zero velocity in mode ``walk``."""
        if self._by_velocity and not self._halting and self.motion is None:
            before = self._barred, self._released
            self._stop()
            self._barred, self._released = before

    def take_motion(self) -> str | None:
        """Name of a motion to plan and follow, returned once; ``"stop"`` holds the present posture."""
        pending, self._pending = self._pending, None
        return pending

    def take_velocity(self) -> Velocity | None:
        """Walking velocity of a text command, returned once; zero requests a standstill."""
        velocity, self._velocity = self._velocity, None
        return velocity

    def motion_refused(self, reason: str) -> CommandReply:
        """Return to standing: the requested motion could not be planned or followed. The reply names the motion."""
        reply = CommandReply(False, f"motion '{self.motion}' refused: {reason}")
        if self.mode is Mode.MOTION:
            self._enter(Mode.STAND, reason)
        self.motion = None
        return reply

    def estop(self) -> CommandReply:
        """Damp at once and latch; also in mode ``off``, because the start of a real robot may hold it stiff."""
        self.fault(_EMERGENCY_STOP)
        if self.mode is Mode.OFF:
            self._enter(Mode.DAMP, _EMERGENCY_STOP)
        return CommandReply(True, f"{self.mode.value}: {_EMERGENCY_STOP}")

    @property
    def stopped(self) -> bool:
        """Whether an emergency stop is latched."""
        return _EMERGENCY_STOP in self.faults

    def fault(self, reason: str, severity: Severity = Severity.DAMP) -> CommandReply:
        """Latch ``reason`` and damp, or come to a stand for severity ``STAND`` (see the law above).

        Mode ``off`` does not change. Severity ``STAND`` changes only the modes ``walk`` and ``motion``.
        """
        new = reason not in self.faults
        if new:
            self.faults = (*self.faults, reason)
        if severity is Severity.STAND:
            self._passing.add(reason)
        if severity is Severity.DAMP and self.mode is not Mode.OFF:
            self._enter(Mode.DAMP, reason)
        elif severity is Severity.STAND and new and self.mode in (Mode.WALK, Mode.MOTION):
            self._stop()
        return CommandReply(True, f"{self.mode.value}: {reason}")

    def reset_faults(self) -> CommandReply:
        """Clear the latched faults; the mode does not change."""
        if not self.faults:
            return CommandReply(True, "no faults were latched")
        cleared, self.faults = self.faults, ()
        return CommandReply(True, f"cleared: {'; '.join(cleared)}")

    def update(self, health: Health, t: float) -> Mode:
        """Update faults and mode from the reports of the other nodes at time t [s]; returns the mode."""
        if self.mode not in ACTIVE_MODES:
            return self.mode
        problems = health.problems(self.config, t)
        self.holds = tuple(reason for severity, reason in problems if severity is Severity.HOLD)
        for severity, reason in problems:
            if severity is not Severity.HOLD:
                self.fault(reason, severity)
        if self.mode is Mode.STAND:
            over = self._passing.difference(reason for _, reason in problems)
            self.faults = tuple(reason for reason in self.faults if reason not in over)
        if self.motion is not None:
            self._follow_motion(health.motion_active, t)
        if self.mode is Mode.WALK and (self.holds or not self.gait) and not self._halting:
            self._stop()
        if self._halting and not health.gait_active:
            self._enter(Mode.STAND, "standstill")
        return self.mode

    def _follow_motion(self, active: bool, t: float) -> None:
        """Return to standing, or continue walking, when the motion ends or does not start in time."""
        if self._motion_since is None:
            self._motion_since = t
        self._motion_seen |= active
        if self._motion_seen and not active and self._pending is None:
            self.motion = None
            if self.mode is Mode.MOTION:
                self._enter(Mode.STAND, "motion completed")
        elif not self._motion_seen and t - self._motion_since > self.config.plan_timeout:
            self.motion_refused(f"no trajectory within {self.config.plan_timeout:.0f} s")

    def _start_motion(self, name: str) -> CommandReply:
        allowed = self.config.walking_motions
        if self.mode is Mode.WALK and name not in allowed:
            known = ", ".join(allowed) or "nothing"
            return CommandReply(False, f"'{name}' refused in mode 'walk', only: {known}; request 'stand' first")
        if self.mode in ACTIVE_MODES and (self.faults or self.holds):
            return CommandReply(False, f"'{name}' refused: {'; '.join((*self.faults, *self.holds))}")
        if self.motion is not None:
            return CommandReply(False, f"'{name}' refused: busy with '{self.motion}'; send 'stop' first")
        if self.mode is Mode.WALK:
            if self._halting:
                return CommandReply(False, f"'{name}' refused: the robot comes to a standstill")
            self._motion_seen, self._motion_since = False, None
        elif self.mode is not Mode.STAND:
            return CommandReply(False, f"'{name}' refused in mode '{self.mode.value}'; {self._to_stand}")
        else:
            self._enter(Mode.MOTION, name)
        self.motion = self._pending = name
        return CommandReply(True, f"motion '{name}' requested")

    def _walk(self) -> CommandReply:
        if not self.gait:
            return self._refuse(Mode.WALK, "no gait planner runs")
        if self.mode in ACTIVE_MODES and (self.faults or self.holds):
            return self._refuse(Mode.WALK, "; ".join((*self.faults, *self.holds)))
        if self.mode is Mode.WALK:
            self._halting = False
            return CommandReply(True, "walk: continues")
        if self.held and self.mode is Mode.STAND:
            return self._refuse(
                Mode.WALK, "the robot is held at its start until its feet bear the weight; request it again then"
            )
        if self.mode is not Mode.STAND:
            return self._refuse(Mode.WALK, self._to_stand)
        return self._enter(Mode.WALK, "the robot steps when a velocity is commanded")

    def _gait_word(self, word: str) -> CommandReply:
        if not self.gait:
            return CommandReply(False, f"'{word}' refused: no gait planner runs")
        if self.holds:
            return self._refuse(Mode.WALK, "; ".join(self.holds))
        reply = self.request(Mode.WALK)
        if not reply.accepted or word == "walk":
            return reply
        config = self.config
        self._velocity = velocity = {
            "forward": (config.text_speed, 0.0, 0.0),
            "backward": (-config.text_speed, 0.0, 0.0),
            "left": (0.0, config.text_side_speed, 0.0),
            "right": (0.0, -config.text_side_speed, 0.0),
            "turn": (0.0, 0.0, config.text_turn),
            "spin": (0.0, 0.0, config.text_spin),
        }[word]
        return CommandReply(
            True, f"walk: {velocity[0]:g} m/s forward, {velocity[1]:g} m/s left, {velocity[2]:g} rad/s, until 'stop'"
        )

    def _stop(self) -> CommandReply:
        self._bar()
        if self.mode is Mode.WALK:
            self._velocity, self._halting = (0.0, 0.0, 0.0), True
            if self.motion is not None:
                self.motion, self._pending = None, "stop"
            return CommandReply(True, "walk: comes to a standstill")
        if self.mode is Mode.STAND:
            self._pending = "stop"  # for a trajectory that was not requested from the supervisor
            return CommandReply(True, "stand: holding this posture")
        if self.mode is not Mode.MOTION:
            return CommandReply(True, f"nothing to stop in mode '{self.mode.value}'")
        stopped = self.motion
        self._enter(Mode.STAND, "stop")
        self._pending = "stop"
        return CommandReply(True, f"motion '{stopped}' stopped; holding this posture")

    def _bar(self) -> None:
        """Bar velocities that continue from before now."""
        self._barred, self._released = True, set()

    def _enter(self, mode: Mode, reason: str) -> CommandReply:
        if self.mode in ACTIVE_MODES and mode not in ACTIVE_MODES:
            self.preflight = (f"preflight checks have not been repeated since mode '{mode.value}'",)
            self.holds = ()
        if mode not in ACTIVE_MODES or self.mode not in ACTIVE_MODES:
            self._bar()
        self.mode = mode
        self.motion = self._pending = None
        self._velocity, self._halting, self._by_velocity = None, False, False
        self._motion_seen, self._motion_since = False, None
        return CommandReply(True, f"{mode.value}: {reason}")

    def _refuse(self, mode: Mode, reason: str) -> CommandReply:
        return CommandReply(False, f"mode '{mode.value}' refused from '{self.mode.value}': {reason}")
