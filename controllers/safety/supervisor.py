"""Mode machine of the robot: mode requests, text commands, faults and refusals with their reason.

The law:

    off -> damp -> stand <-> motion        stand <-> walk where there is a gait planner; some motions while walking

    fault of severity hold                 no velocity and no new motion, while the cause lasts
                      stand                walk, motion -> stand, latched until ``reset_faults``
                      damp                 any but off -> damp, latched until ``reset_faults``

Arming requires preflight checks that passed since the robot was last active: it may have been moved since.

It has no clock and no I/O: time is an argument of ``update``. The node around it publishes ``mode``, sends the names
from ``take_motion`` to the motion planner, and answers services with the ``CommandReply`` of this class.
"""

from controllers.commands.arbitration import Velocity
from controllers.safety.health import Health, Severity, SupervisorConfig
from models.config import default_config
from models.robot_model import RobotModel
from models.types import CommandReply, Mode

#: Text commands that need a gait planner; answered with the reason while there is none
GAIT_WORDS = ("walk", "forward", "backward", "left", "right", "turn", "spin")
#: Modes in which the whole-body controller moves the joints
ACTIVE_MODES = frozenset({Mode.STAND, Mode.WALK, Mode.MOTION})


class Supervisor:
    """Guarded mode transitions, text commands and the fault latch.

    Args:
        model: Robot to supervise.
        config: Limits and vocabulary; the packaged ``controllers/config/supervisor.yaml`` when None.
        gait: Whether there is a gait planner; without one every request to walk is refused.

    Attributes:
        mode: Present mode.
        faults: Reasons of the latched faults.
        holds: Reasons of the present faults of severity hold.
        motion: Name of the motion requested or under way; None without one.
        ignored: Number of text commands ignored so far.
    """

    def __init__(self, model: RobotModel, config: SupervisorConfig | None = None, *, gait: bool = False) -> None:
        self.model = model
        self.gait = gait
        self.config = default_config(SupervisorConfig, "controllers", "supervisor") if config is None else config
        self.ignored = 0
        self.reset()

    def reset(self, mode: Mode = Mode.OFF) -> None:
        """Clear faults, findings and pending motions and start in ``mode``."""
        self.mode = mode
        self.faults: tuple[str, ...] = ()
        self.holds: tuple[str, ...] = ()
        self.motion: str | None = None
        self._preflight: tuple[str, ...] = ("preflight checks have not run yet",)
        self._pending: str | None = None
        self._velocity: Velocity | None = None
        self._halting = False
        self._motion_seen = False
        self._motion_since: float | None = None

    @property
    def preflight(self) -> tuple[str, ...]:
        """Findings of the last preflight check; empty when it passed."""
        return self._preflight

    @property
    def still(self) -> bool:
        """Whether velocities are ignored: a walk is ending, or a fault of severity hold is present."""
        return self._halting or bool(self.holds)

    def set_preflight(self, findings: tuple[str, ...]) -> None:
        """Store the findings of ``controllers.safety.preflight``; arming is refused until they are empty."""
        self._preflight = findings

    def request(self, mode: Mode) -> CommandReply:
        """Request a mode; the reply has the reason of a refusal. ``stand`` from ``off`` passes through ``damp``."""
        if mode is self.mode and not self._halting:
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
            return self._refuse(mode, f"name a motion instead: {', '.join(self.config.motions)}")
        if self.mode in (Mode.MOTION, Mode.WALK):
            return self._stop()
        if self.faults:
            return self._refuse(mode, f"latched faults: {'; '.join(self.faults)}; call reset_faults first")
        if self._preflight:
            return self._refuse(mode, f"preflight: {'; '.join(self._preflight)}")
        return self._enter(Mode.STAND, "standing")

    def text(self, command: str) -> CommandReply:
        """Execute a text command such as ``"wave"``, or reply with the reason of the refusal.

        Case and surrounding blanks do not matter. Unknown and oversized text is ignored and counted.
        """
        if len(command) > self.config.text_length_max:
            self.ignored += 1
            return CommandReply(
                False, f"command of {len(command)} characters ignored: limit is {self.config.text_length_max}"
            )
        word = command.strip().lower()
        if word == "stop":
            return self._stop()
        if word == "stand":
            return self.request(Mode.STAND) if self.mode is not Mode.STAND else self._start_motion("stand")
        if word in self.config.motions:
            return self._start_motion(word)
        if word in GAIT_WORDS:
            return self._gait_word(word)
        self.ignored += 1
        known = ", ".join((*self.config.motions, "stand", "stop", *GAIT_WORDS))
        return CommandReply(False, f"unknown command {word[:32]!r} ignored; known: {known}")

    def take_motion(self) -> str | None:
        """Name of a motion to plan and follow, returned once; ``"stop"`` means hold the present posture."""
        pending, self._pending = self._pending, None
        return pending

    def take_velocity(self) -> Velocity | None:
        """Walking velocity of a text command, returned once; zero comes to a standstill."""
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
        """Damp at once and latch."""
        return self.fault("emergency stop")

    def fault(self, reason: str, severity: Severity = Severity.DAMP) -> CommandReply:
        """Damp or come to a stand, and latch until ``reset_faults``; ``off`` stays off. Always accepted.

        Args:
            reason: Named in ``faults`` and in later refusals.
            severity: ``DAMP``, or ``STAND``, which leaves a robot that does not move its feet as it is.
        """
        new = reason not in self.faults
        if new:
            self.faults = (*self.faults, reason)
        if severity is Severity.DAMP and self.mode is not Mode.OFF:
            self._enter(Mode.DAMP, reason)
        elif severity is Severity.STAND and new and self.mode in (Mode.WALK, Mode.MOTION):
            self._stop()
        return CommandReply(True, f"{self.mode.value}: {reason}")

    def reset_faults(self) -> CommandReply:
        """Release the latch; the mode stays where it is until another one is requested."""
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
        if self.motion is not None:
            self._follow_motion(health.motion_active, t)
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
                self._enter(Mode.STAND, "motion done")
        elif not self._motion_seen and t - self._motion_since > self.config.plan_timeout:
            self.motion_refused(f"nothing to follow after {self.config.plan_timeout:.0f} s")

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
            return CommandReply(False, f"'{name}' refused in mode '{self.mode.value}'; request 'stand' first")
        else:
            self._enter(Mode.MOTION, name)
        self.motion = self._pending = name
        return CommandReply(True, f"motion '{name}' requested")

    def _walk(self) -> CommandReply:
        if not self.gait:
            return self._refuse(Mode.WALK, "no gait planner is configured")
        if self.mode in ACTIVE_MODES and (self.faults or self.holds):
            return self._refuse(Mode.WALK, "; ".join((*self.faults, *self.holds)))
        if self.mode is Mode.WALK:
            self._halting = False
            return CommandReply(True, "walk: goes on")
        if self.mode is not Mode.STAND:
            return self._refuse(Mode.WALK, "request 'stand' first")
        return self._enter(Mode.WALK, "steps when a velocity is commanded")

    def _gait_word(self, word: str) -> CommandReply:
        if not self.gait:
            return CommandReply(False, f"'{word}' refused: no gait planner is configured")
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
        return CommandReply(True, f"walk: {velocity[0]:g} m/s forward, {velocity[1]:g} m/s left, {velocity[2]:g} rad/s")

    def _stop(self) -> CommandReply:
        if self.mode is Mode.WALK:
            self._velocity, self._halting = (0.0, 0.0, 0.0), True
            if self.motion is not None:
                self.motion, self._pending = None, "stop"
            return CommandReply(True, "walk: comes to a standstill")
        if self.mode is Mode.STAND:
            self._pending = "stop"  # of a trajectory that was not requested from the supervisor
            return CommandReply(True, "stand: holding this posture")
        if self.mode is not Mode.MOTION:
            return CommandReply(True, f"nothing to stop in mode '{self.mode.value}'")
        stopped = self.motion
        self._enter(Mode.STAND, "stop")
        self._pending = "stop"
        return CommandReply(True, f"motion '{stopped}' stopped; holding this posture")

    def _enter(self, mode: Mode, reason: str) -> CommandReply:
        if self.mode in ACTIVE_MODES and mode not in ACTIVE_MODES:
            self._preflight = (f"preflight checks have not been repeated since mode '{mode.value}'",)
        self.mode = mode
        self.motion = self._pending = None
        self._velocity, self._halting = None, False
        self._motion_seen = False
        self._motion_since = None
        return CommandReply(True, f"{mode.value}: {reason}")

    def _refuse(self, mode: Mode, reason: str) -> CommandReply:
        return CommandReply(False, f"mode '{mode.value}' refused from '{self.mode.value}': {reason}")
