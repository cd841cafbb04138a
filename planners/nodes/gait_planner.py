"""Node ``gait_planner``: velocities and goals in; footsteps and phase out; the reference goes over as an object."""

from __future__ import annotations

from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from models.applied import Applied
from models.config import default_config
from models.errors import CommandError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.parameters import declare_config, describe
from models.nodes.tick_timer import TickTimer
from models.types import Reference, RobotState
from planners.gait.command import VelocityCommand
from planners.gait.config import GaitConfig
from planners.gait.footsteps import Foothold
from planners.gait.gait import GaitPlanner
from planners.gait.measurement import GaitMeasurement
from planners.gait.noted import NotedGait
from planners.gait.scaling import load_gait_config
from planners.nodes.gait_topics import GaitTopics, declare_rates
from planners.nodes.route_topics import RouteTopics
from planners.nodes.velocity_topics import VelocityTopics


class GaitPlannerNode(PoiseNode):
    """Runs ``GaitPlanner`` for a controller in the same process, which calls ``reset``, ``step`` and ``settled``.

    The law runs at the controller's rate, so its reference is handed over without a message; ``tell`` publishes
    afterwards what others may want to know.

    Args:
        applied: Notes what the law is told, for a replay; None for nobody.
        kwargs: Passed to rclpy.
    """

    def __init__(self, *, applied: Applied | None = None, **kwargs: Any) -> None:
        super().__init__("gait_planner", **kwargs)
        self._applied = applied
        self._config = declare_config(self, self._default())
        text = describe("Silence of the supervisor after which the robot stops [s]", low=0.01, high=10.0)
        timeout = float(self.declare_parameter("command_timeout", 0.5, text).value)
        self._periods = declare_rates(self)
        self._command = VelocityCommand(timeout)
        self._timer = TickTimer()
        self._stamp = 0
        self._state: RobotState | None = None
        self._begun = False

    def _default(self) -> GaitConfig:
        """The robot's own gait. Of a robot that cannot be loaded, ``configure`` tells; here any gait will do."""
        try:
            return load_gait_config(self.model)
        except PoiseError:
            return default_config(GaitConfig, "planners", "gait")

    def configure(self) -> None:
        """Build the law and the topics."""
        if self._applied is None:
            self._law = GaitPlanner(self.model, self._config)
        else:
            self._law = NotedGait(self.model, self._config, self._applied, held=True)
            self._applied.describe("gait", self._config)
            self._applied.watch("gait", self._law)
        self._gait = GaitTopics(self, self._law, self._periods)
        now = lambda: self._stamp  # noqa: E731
        self._velocities = VelocityTopics(self, self._command, now, self._law.stop, self._leave)
        self._routes = RouteTopics(self, self._law, self._command, self._not_walking, self._soles, now)

    def _leave(self) -> None:
        """Mode walk is over: where the soles are is not known until the next walk begins."""
        self._begun = False
        self._law.route.end("mode walk was left")
        self._routes.tell()

    def _not_walking(self) -> str:
        """Why no footsteps can be taken now; empty when they can."""
        if not self._velocities.walking:
            return f"no walking in mode '{self._velocities.mode}': request mode/walk first"
        return "" if self._begun else "mode 'walk' has just been entered: try again"

    def _soles(self) -> list[Foothold]:
        """Where the soles of a robot that does not walk are.

        Raises:
            CommandError: Nobody has told, or they do not stand.
        """
        state = self._state
        if state is None:
            raise CommandError("start: none given, and where the soles are is not known")
        if not all(foot.active for foot in state.contacts):
            raise CommandError("start: none given, and the robot does not stand on both soles")
        measured = GaitMeasurement(self.model)
        measured.update(state)
        return measured.soles

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition; from here on somebody can walk."""
        result = super().on_activate(state)
        if self.active:
            self._begun = False
            self._command.forget()
            self._gait.reset()
            self._gait.tell_phase(topics.GAIT_SETTLED)
        return result

    def deactivate(self) -> None:
        """Nobody can begin to walk; a walk under way comes to a standstill."""
        self._command.forget()
        self._law.stop()
        self._gait.tell_phase(topics.GAIT_ABSENT)

    @property
    def settled(self) -> bool:
        """Whether the robot has come to a standstill."""
        return self._law.settled

    def reset(self, state: RobotState) -> None:
        """Start over from a robot that stands on both feet."""
        self._law.reset(state)
        self._gait.reset()
        self._begun = True

    def step(self, state: RobotState, dt: float) -> Reference:
        """One tick: what the controller is to track."""
        with self._timer:
            if self._command.lapsed(state.t):
                self._law.stop()
            self._law.set_velocity(*self._command.velocity)
            return self._law.step(state, dt)

    def tell(self, stamp: int, state: RobotState | None = None) -> None:
        """After each tick of the process: the stamp of its state [ns], and that; in mode walk, publish what is due."""
        self._stamp, self._state = stamp, state
        if self.active and self._begun and self._velocities.walking:
            self._gait.tell(stamp)
            self._routes.tell()

    def before_diagnostics(self) -> None:
        """Report the gait and what became of the last step."""
        if not self.active:
            return
        if not (self._begun and self._velocities.walking):
            self.message = "ready"
            return
        view = self._law.view
        self.message = view.phase
        target = view.soles.holds[1 - view.stance]
        forward, left = view.soles.holds[view.stance].relative(target.x, target.y)
        self.values["velocity"] = "({:.3f} m/s, {:.3f} m/s, {:.3f} rad/s)".format(*view.velocity)
        self.values["steps"] = str(view.steps)
        self.values["footsteps left"] = str(view.route.left)
        self.values["step time [s]"] = f"{view.step_time:.3f}"
        self.values["foothold from the stance sole [m]"] = f"({forward:.3f}, {left:.3f})"
        self.values["adjustments unsolved"] = str(view.unsolved)
        self.values["capture margin [m]"] = f"{self._gait.margin:.4f}"
        self.values |= self._timer.values()
