"""Node ``gait_planner``: commands the gait from velocities and goals, and publishes footsteps and phase."""

import math
import time
from collections import deque
from itertools import accumulate, chain, islice, repeat
from typing import Any

from geometry_msgs.msg import Twist
from nav_msgs.msg import Path
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from std_msgs.msg import Empty, Float64, String

from models.constants import FOOT_NAMES
from models.errors import CommandError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.odometry import velocity_from_twist
from models.nodes.parameters import declare, declare_period
from models.nodes.qos import COMMAND, EVENT, LATCHED, STATE
from models.nodes.spin import program
from models.status import GaitStatus
from models.types import STILL, Mode, Velocity
from planners.gait.commands import VelocityCommand
from planners.gait.config import GaitConfig
from planners.gait.footsteps import Feet
from planners.gait.planner import GaitPlanner
from planners.gait.route import Footstep
from planners.gait.state import GaitView, capture_margin, coming_steps
from planners.nodes.footstep_messages import path_from_steps
from planners.nodes.gait_commands import RouteTopics
from planners.nodes.gait_link import GaitStage, RemoteGait, declare_gait
from planners.nodes.ground_walk import GroundWalk, declare_ground

WARNING_PERIOD_S = 10.0  #: Between two equal warnings of a walk without a map
TAKEN_MAX = 20  #: Largest number of poses in ``gait/footsteps_taken``


def declare_rates(node: PoiseNode) -> tuple[int, int]:
    """Declare the publication rates of footsteps and margin; returns their periods [ns]."""
    footsteps = declare_period(node, "footstep_rate", 10.0, "the planned footsteps while walking", high=100.0)
    return footsteps, declare_period(node, "margin_rate", 50.0, "the capturability margin in mode walk", high=100.0)


class GaitTopics:
    """Publishes changes of the gait, at the periods of ``declare_rates``; ``margin``: capturability margin [m]."""

    def __init__(self, node: PoiseNode, law: GaitPlanner, periods: tuple[int, int]) -> None:
        self._law, self._periods = law, periods
        self._phase = node.announce(String, topics.GAIT_PHASE, LATCHED)
        self._publish_status = node.announce_status(topics.GAIT_STATUS, LATCHED)
        self._margin = node.announce(Float64, topics.GAIT_CAPTURE_MARGIN, STATE)
        self._planned = node.announce(Path, topics.FOOTSTEPS, EVENT)
        self._taken = node.announce(Path, topics.FOOTSTEPS_TAKEN, EVENT)
        self._history: deque[Any] = deque(maxlen=TAKEN_MAX)
        self._log, self._limited, self._exceeded = node.get_logger(), "", list[str]()
        self._blocked = self._unmapped = ""
        self._warned = "", -math.inf  # last warning of a walk without a map, and its monotonic time [s]
        law.exceeded(STILL)  # computes the limits now and not in a tick
        self.reset()

    def reset(self) -> None:
        """Publish everything again, at the beginning of a walk."""
        self._word, self._steps = "", 0
        self._last_planned = self._last_margin = 0
        self._history.clear()
        self.margin = math.nan

    def publish_phase(self, word: str) -> None:
        """Publish ``gait/phase`` if its word has changed."""
        if word != self._word:
            self._word = word
            self._report()
            self._phase.publish(String(data=word))

    def report_limit(self, velocity: Velocity) -> None:
        """Report how a commanded velocity exceeds the limits, once for each set of components beyond them."""
        exceeded = self._law.exceeded(velocity)
        if list(exceeded) == self._exceeded:
            return
        self._exceeded, self._limited = list(exceeded), ", ".join(exceeded.values())
        if self._limited:
            self._log.warning(f"velocity: {self._limited}")
        self._report()

    def report_ground(self, blocked: str, unmapped: str) -> None:
        """Report new reasons why the robot stands before ground that is not level, and walks without a map."""
        before, self._blocked, self._unmapped = self._blocked, blocked and f"stopped: {blocked}", unmapped
        if self._blocked not in ("", before):
            self._log.warning(self._blocked)
        now = time.monotonic()
        if unmapped and (unmapped != self._warned[0] or now - self._warned[1] > WARNING_PERIOD_S):  # may alternate
            self._warned = unmapped, now
            self._log.warning(unmapped)
        self._report()

    def _report(self) -> None:
        present, still = self._word != topics.GAIT_ABSENT, self._word in (topics.GAIT_SETTLED, topics.GAIT_ABSENT)
        self._publish_status(GaitStatus(present, still, self._limited, self._blocked, self._unmapped))

    def publish(self, stamp: int) -> None:
        """Publish everything that is due at a stamp [ns]."""
        law = self._law
        if law.settled:
            word = topics.GAIT_SETTLED
        else:
            word = law.phase.value + (f" {FOOT_NAMES[1 - law.stance]}" if law.phase.value == "single" else "")
        view = None
        if stamp - self._last_margin >= self._periods[1]:
            self._last_margin, view = stamp, law.view
            self.margin = capture_margin(view, law.config)
            self._margin.publish(Float64(data=self.margin))
        if law.steps != self._steps:
            self._steps, view = law.steps, view or law.view
            self._history.append((Footstep(law.stance, law.footholds[law.stance]), stamp))
            steps, stamps = zip(*self._history, strict=True)
            self._taken.publish(path_from_steps(stamp, steps, stamps))
        if law.walking and (word != self._word or stamp - self._last_planned >= self._periods[0]):
            self._last_planned = stamp
            self._planned.publish(self._plan(stamp, view or law.view, law.config))
        self.publish_phase(word)

    @staticmethod
    def _plan(stamp: int, view: GaitView, config: GaitConfig) -> Any:
        """Next footsteps with their touchdown times."""
        gait = view.state
        singles = (max(gait.pace.single, step.time) for step in gait.command.route.steps[1:])
        periods = (
            round((single + gait.pace.double) * NANOSECONDS) for single in chain(singles, repeat(gait.pace.single))
        )
        wait = gait.step.time if view.swinging else gait.single + gait.pace.double
        t = stamp + round(max(wait - gait.elapsed, 0.0) * NANOSECONDS)
        feet = (1 - gait.stance, gait.stance)
        steps = [Footstep(feet[i % 2], hold) for i, hold in enumerate(coming_steps(view, config))]
        return path_from_steps(stamp, steps, list(islice(accumulate(periods, initial=t), len(steps))))


class GaitPlannerNode(PoiseNode):
    """Commands the gait of a control stack in this process, or in another one by messages if ``stack`` is None."""

    def __init__(self, stack: GaitStage | None = None, **kwargs: Any) -> None:
        super().__init__("gait_planner", **kwargs)
        self._stack = RemoteGait(self, self._on_report) if stack is None else stack
        self._config = declare_gait(self)
        text = "Timeout of the supervisor's velocities, after which the robot stops [s]"
        timeout = declare(self, "command_timeout", 0.5, text, low=0.01, high=10.0)
        self._periods = declare_rates(self)
        self._ground_config = declare_ground(self)
        self._command = VelocityCommand(timeout)
        self._stamp = 0
        self._begun = False

    def configure(self) -> None:
        self._law = self._stack.build_gait(self.model, self._config)
        self._gait = GaitTopics(self, self._law, self._periods)
        now = lambda: self._stamp  # noqa: E731
        self._mode = ""  # none was received
        self.listen(Twist, topics.GAIT_VELOCITY, self._on_velocity, COMMAND, while_active=True)
        self.listen(Empty, topics.GAIT_STOP, lambda message: self._stop("stopped"), EVENT)
        self.listen(String, topics.MODE, self._on_mode, LATCHED)
        self._ground = GroundWalk(self, self._law, self._stack, self._ground_config, self._gait.report_ground)
        law, stack, command = self._law, self._stack, self._command
        self._routes = RouteTopics(self, law, stack, command, self._not_walking, self._soles, now, self._ground)

    @property
    def _walking(self) -> bool:
        return self._mode == Mode.WALK.value

    def _on_velocity(self, message: Any) -> None:
        """Store a velocity of the supervisor, which arbitrates the sources; it may arrive just before its mode."""
        velocity = velocity_from_twist(message)
        self._gait.report_limit(velocity)
        self._command.repeat(velocity, self._stamp / NANOSECONDS)

    def _stop(self, reason: str) -> None:
        """Come to a standstill."""
        self._ground.cancel(reason)
        self._stack.stop()

    def _on_mode(self, message: Any) -> None:
        if self._walking:  # also on "walk" again: the mode in between and the status of the new walk would be lost
            self._leave()
        self._mode = message.data

    def _leave(self) -> None:
        """End of mode walk: the command is discarded, the poses of the soles are unknown until the next walk."""
        self._command.forget()
        self._begun = False
        self._gait.report_limit(STILL)
        self._stack.hold_velocity(*STILL)
        self._ground.cancel("mode walk was left")
        self._law.end_route("mode walk was left")
        self._routes.publish_end()

    def _not_walking(self) -> str:
        """Reason why no footsteps can be taken now; empty if they can."""
        if not self._walking:
            return f"no walking in mode '{self._mode}': request mode/walk first"
        return "" if self._begun else "mode 'walk' has just been entered: try again"

    def _soles(self) -> Feet:
        """Poses of the soles of a robot that does not walk. Raises ``CommandError`` if unknown or not standing."""
        measured = self._law.state.measured
        if self._mode not in (Mode.STAND.value, Mode.MOTION.value, Mode.WALK.value):
            raise CommandError("start: none given, and the poses of the soles are unknown")
        if not all(measured.active):
            raise CommandError("start: none given, and the robot does not stand on both soles")
        return measured.soles

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition, after which the robot can walk."""
        result = super().on_activate(state)
        if self.active:
            self._begun = False
            self._command.forget()
            self._gait.reset()
            self._gait.publish_phase(topics.GAIT_SETTLED)
        return result

    def deactivate(self) -> None:
        """Stop a walk under way; no other one can begin."""
        self._command.forget()
        self._stack.hold_velocity(*STILL)
        self._stop("the gait planner was deactivated")
        self._routes.publish_end()
        self._gait.publish_phase(topics.GAIT_ABSENT)

    def before_tick(self, t: float) -> None:
        """Apply the commanded velocity, which must be repeated; called before each tick with its stamp [s]."""
        if not self._walking:
            return
        if self._command.lapsed(t):
            self._stop("the velocity was not repeated")
        self._stack.hold_velocity(*self._ground.admit(self._command.velocity))

    def _on_report(self, stamp: int) -> None:
        """Handle the report of a controller in another process, after its tick with a stamp [ns]."""
        self.before_tick(stamp / NANOSECONDS)
        self.publish(stamp)

    def publish(self, stamp: int) -> None:
        """Publish what is due at the stamp of a tick [ns], in mode walk; called after each tick of the process."""
        self._stamp = stamp
        if self._stack.walking and self._walking and not self._begun:
            self._gait.reset()
            self._begun = True
        if self.active and self._begun and self._walking:
            self._ground.update(stamp / NANOSECONDS)
            self._gait.publish(stamp)
            self._routes.publish_end()

    def before_diagnostics(self) -> None:
        if not self.active:
            return
        if not (self._begun and self._walking):
            self.message = "ready"
            return
        gait, holds = self._law.state, self._law.footholds
        self.message = gait.phase.value
        target = holds[1 - gait.stance]
        forward, left = holds[gait.stance].relative(target.x, target.y)
        self.values["velocity"] = "({:.3f} m/s, {:.3f} m/s, {:.3f} rad/s)".format(*gait.command.velocity)
        self.values["steps"] = str(gait.steps)
        self.values["footsteps left"] = str(gait.command.route.left)
        self.values["step time [s]"] = f"{gait.step.time:.3f}"
        self.values["foothold from the stance sole [m]"] = f"({forward:.3f}, {left:.3f})"
        self.values["adjustments unsolved"] = str(gait.step.unsolved)
        self.values["capture margin [m]"] = f"{self._gait.margin:.4f}"


main = program(GaitPlannerNode)  #: Commands the gait of a controller in another process


if __name__ == "__main__":
    main()
