"""Node ``gait_planner``: velocities and goals in; footsteps and phase out; the reference is passed as an object."""

from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from models.config import default_config
from models.errors import CommandError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.parameters import declare, declare_config
from models.nodes.realtime import TickTimer
from models.types import RobotState
from planners.gait.commands import STILL, VelocityCommand
from planners.gait.config import GaitConfig, load_gait_config
from planners.gait.contact import GaitMeasurement
from planners.gait.footsteps import Feet
from planners.nodes.gait_stage import GaitStage
from planners.nodes.gait_topics import GaitTopics, declare_rates
from planners.nodes.route_topics import RouteTopics
from planners.nodes.velocity_topics import VelocityTopics


class GaitPlannerNode(PoiseNode):
    """Commands the gait of a control stack in the same process, which gets the reference without a message."""

    def __init__(self, stack: GaitStage, **kwargs: Any) -> None:
        super().__init__("gait_planner", **kwargs)
        self._stack = stack
        self._config = declare_config(self, self._default())
        text = "Silence of the supervisor after which the robot stops [s]"
        timeout = declare(self, "command_timeout", 0.5, text, low=0.01, high=10.0)
        self._periods = declare_rates(self)
        self._command = VelocityCommand(timeout)
        self._timer = TickTimer()
        self._stamp = 0
        self._state: RobotState | None = None
        self._begun = False

    def _default(self) -> GaitConfig:
        """The gait of the robot; that of any robot when it cannot be loaded, which ``configure`` reports."""
        try:
            return load_gait_config(self.model)
        except PoiseError:
            return default_config(GaitConfig, "planners", "gait")

    def configure(self) -> None:
        """Build the law and the topics."""
        self._law = self._stack.build_gait(self.model, self._config, self._timer)
        self._gait = GaitTopics(self, self._law, self._periods)
        now = lambda: self._stamp  # noqa: E731
        self._velocities = VelocityTopics(self, self._command, now, self._stack.stop, self._leave)
        self._routes = RouteTopics(self, self._law, self._stack, self._command, self._not_walking, self._soles, now)

    def _leave(self) -> None:
        """Mode walk has ended: the soles' poses are unknown until the next walk."""
        self._begun = False
        self._stack.hold_velocity(*STILL)
        self._law.end_route("mode walk was left")
        self._routes.publish_end()

    def _not_walking(self) -> str:
        """Why no footsteps can be taken now; empty when they can."""
        if not self._velocities.walking:
            return f"no walking in mode '{self._velocities.mode}': request mode/walk first"
        return "" if self._begun else "mode 'walk' has just been entered: try again"

    def _soles(self) -> Feet:
        """Poses of the soles of a robot that does not walk; ``CommandError`` when unknown or not standing."""
        state = self._state
        if state is None:
            raise CommandError("start: none given, and where the soles are is not known")
        if not all(foot.active for foot in state.contacts):
            raise CommandError("start: none given, and the robot does not stand on both soles")
        return GaitMeasurement(self.model).measure(state).soles

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition; from here on the robot can walk."""
        result = super().on_activate(state)
        if self.active:
            self._begun = False
            self._command.forget()
            self._gait.reset()
            self._gait.publish_phase(topics.GAIT_SETTLED)
        return result

    def deactivate(self) -> None:
        """No walk can begin; one under way comes to a standstill."""
        self._command.forget()
        self._stack.hold_velocity(*STILL)
        self._stack.stop()
        self._gait.publish_phase(topics.GAIT_ABSENT)

    def before_tick(self, t: float) -> None:
        """Before each tick of the process: apply the commanded velocity, which must be repeated, at a stamp [s]."""
        if not self._velocities.walking:
            return
        if self._command.lapsed(t):
            self._stack.stop()
        self._stack.hold_velocity(*self._command.velocity)

    def publish(self, stamp: int, state: RobotState | None = None) -> None:
        """After each tick of the process, in mode walk: publish what is due for its stamp [ns] and state."""
        self._stamp, self._state = stamp, state
        if self._stack.walking and self._velocities.walking and not self._begun:
            self._gait.reset()
            self._begun = True
        if self.active and self._begun and self._velocities.walking:
            self._gait.publish(stamp)
            self._routes.publish_end()

    def before_diagnostics(self) -> None:
        """Report the gait and the outcome of the last step."""
        if not self.active:
            return
        if not (self._begun and self._velocities.walking):
            self.message = "ready"
            return
        view = self._law.view
        self.message = view.phase
        target = view.footholds[1 - view.stance]
        forward, left = view.footholds[view.stance].relative(target.x, target.y)
        self.values["velocity"] = "({:.3f} m/s, {:.3f} m/s, {:.3f} rad/s)".format(*view.velocity)
        self.values["steps"] = str(view.steps)
        self.values["footsteps left"] = str(view.route.left)
        self.values["step time [s]"] = f"{view.step_time:.3f}"
        self.values["foothold from the stance sole [m]"] = f"({forward:.3f}, {left:.3f})"
        self.values["adjustments unsolved"] = str(view.unsolved)
        self.values["capture margin [m]"] = f"{self._gait.margin:.4f}"
        self.values |= self._timer.values()
