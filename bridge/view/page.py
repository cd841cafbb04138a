"""``poise view``: a browser page that shows and steers a running robot."""

import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from rcl_interfaces.msg import ParameterType
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

from bridge.ros.client import Client
from bridge.ros.operator import Operator
from bridge.view.controls import Controls, LivePlots
from bridge.view.ground import GroundScene
from bridge.view.listener import Listener, ViewConfig
from bridge.view.scene import WORLD, BalanceScene, RobotScene
from bridge.view.server import CAMERA, serve
from controllers.commands.command_signature import Signer
from controllers.safety.health import SupervisorConfig
from models.config import default_config
from models.nodes.spin import Stop
from models.robot_model import RobotModel
from planners.gait.scaling import load_gait_config

STEPS = 200  #: Positions of a slider [-]
REACH = 4.0  #: Upper end of a slider as a multiple of its initial value, within the range of the parameter [-]
USUAL = "whole_body."  #: Common prefix of names, omitted in the labels


class Gains:
    """Sliders for the float parameters of a node that have a range and are not read-only.

    A refused value is reported with the reason, and the slider is reset. Requests are repeated after ``timeout`` [s].
    """

    def __init__(
        self,
        gui: Any,
        place: Any,
        client: Client,
        operator: Operator,
        node: str,
        report: Callable[[str], object],
        timeout: float,
    ) -> None:
        self._gui, self._place, self._operator, self._node, self._report = gui, place, operator, node, report
        self._parameters, self._timeout = AsyncParameterClient(client.node, node), timeout
        self._asked_at: float | None = None
        self._asked: dict[str, int] = {}
        self._accepted: dict[str, float] = {}
        self.sliders: dict[str, Any] = {}

    def ask(self) -> None:
        """Request the parameters once the node exists, and again after the timeout."""
        now = time.monotonic()
        due = self._asked_at is None or (not self.sliders and now - self._asked_at > self._timeout)
        if due and self._parameters.services_are_ready():
            self._asked_at = now
            self._then(self._parameters.list_parameters(), self._on_list)

    def _on_list(self, answer: Any) -> None:
        names = list(answer.result.names)
        self._then(self._parameters.describe_parameters(names), self._on_descriptors)

    def _on_descriptors(self, answer: Any) -> None:
        free = [
            item
            for item in answer.descriptors
            if not item.read_only and item.type == ParameterType.PARAMETER_DOUBLE and item.floating_point_range
        ]
        if free:
            names = [item.name for item in free]
            self._then(self._parameters.get_parameters(names), lambda values: self._on_values(free, values))

    def _on_values(self, descriptors: list[Any], answer: Any) -> None:
        if self.sliders:  # a late answer to a repeated request
            return
        with self._place:
            for item, value in zip(descriptors, answer.values, strict=True):
                self._add(item, float(value.double_value))

    def _add(self, item: Any, value: float) -> None:
        given = item.floating_point_range[0]
        low = max(given.from_value, min(0.0, REACH * value))
        high = min(given.to_value, max(REACH * abs(value), low + 1.0))
        slider = self._gui.add_slider(
            item.name.removeprefix(USUAL),
            low,
            high,
            (high - low) / STEPS,
            min(max(value, low), high),
            hint=f"{item.name}: {item.description}",
        )
        self.sliders[item.name] = slider
        self._accepted[item.name] = value

        def on_update(event: Any) -> None:
            if event.client is not None:  # moved by the user
                value = float(slider.value)
                self._operator.post(lambda: self.move(item.name, value))

        slider.on_update(on_update)

    def move(self, name: str, value: float) -> None:
        """Set a parameter of the node; if the newest value is refused, the slider is reset."""
        self._asked[name] = number = self._asked.get(name, 0) + 1

        def on_result(answer: Any) -> None:
            result = answer.results[0]
            if result.successful:
                self._accepted[name] = value
                self._report(f"{name} = {value:g}")
            else:
                self._report(f"{name} = {value:g} refused: {result.reason}")
                if number == self._asked[name]:
                    self.sliders[name].value = self._accepted[name]

        self._then(self._parameters.set_parameters([Parameter(name, value=value)]), on_result)

    def _then(self, future: Any, go_on: Callable[[Any], None]) -> None:
        """Call ``go_on`` with the answer, or report the error."""

        def done(future: Any) -> None:
            error = future.exception()
            if error is None:
                go_on(future.result())
            else:
                self._report(f"parameters of {self._node}: {error}")

        future.add_done_callback(done)


TUNED = "balance_controller"  #: Node whose gains get sliders


class Every:
    """Periodic schedule with a rate [Hz] from a time [s]; late calls do not shift it. ``next`` is the next due time."""

    def __init__(self, rate: float, now: float) -> None:
        self._period, self.next = 1.0 / rate, now

    def due(self, now: float) -> bool:
        """Whether a new period has begun since the last call."""
        late = now - self.next
        if late < 0.0:
            return False
        self.next += self._period * (1.0 + late // self._period)
        return True


class Page:
    """Page of one robot at ``url``; commands are unsigned without ``signer``. ``PoiseError`` if the port is in use."""

    def __init__(
        self, model: RobotModel, client: Client, *, host: str, port: int, signer: Signer | None = None
    ) -> None:
        self._client, self._config = client, default_config(ViewConfig, "bridge", "view")
        self._server, self.url = serve(host, port, model.name)
        gui, scene = self._server.gui, self._server.scene
        self._flat = gui.add_html("")
        self._waiting = scene.add_label("/waiting", "waiting for the robot", position=CAMERA[1], anchor="center-center")
        self._world = scene.add_frame(WORLD, show_axes=False, visible=False)
        scene.add_grid(f"{WORLD}/floor", width=40.0, height=40.0, cell_size=0.25, section_size=1.0)
        self._listener = Listener(model, client, self._config)
        self.robot = RobotScene(scene, model)
        self._balance = BalanceScene(scene, model, self._config)
        self._ground = GroundScene(scene, client.node, self._config.silence)
        self._map_due = Every(self._config.map_rate, time.monotonic())
        self._operator = Operator(client, lambda text: self._controls.report(text), signer)
        words = (*default_config(SupervisorConfig, "controllers", "supervisor").motions, "stop")
        limits = load_gait_config(model).velocity
        tabs = gui.add_tab_group()
        with tabs.add_tab("robot"):
            self._controls = Controls(
                gui, self._operator, self._config, [w for w in words if not w.startswith("calibrate")], limits
            )
        with tabs.add_tab("plots"):
            self._plots = LivePlots(gui, model, self._config)
        with tabs.add_tab("gains") as tab:
            gui.add_markdown(f"Parameters of `{TUNED}` that may be changed while it runs.")
            self._gains = Gains(
                gui, tab, client, self._operator, TUNED, self._controls.report, self._config.answer_timeout
            )

    def run(self, stop: Callable[[], bool]) -> None:
        """Update the page and publish commands until ``stop`` returns True."""
        rates = self._config.drive_rate, self._config.rate, self._config.plot_rate
        drive, picture, plot = every = tuple(Every(rate, time.monotonic()) for rate in rates)
        while not stop():
            self._operator.do_posted()
            now, browsers = time.monotonic(), self._server.get_clients()
            if drive.due(now):
                self._operator.drive(self._controls.sticks.velocity(browsers))
            pictures, plots = picture.due(now), plot.due(now)
            if browsers and (pictures or plots):
                self._show(plot=plots)
                # Pictures take at most half the time, so that plots and commands go on on a busy machine.
                picture.next = max(picture.next, 2.0 * time.monotonic() - now)
            if plots:
                self._gains.ask()
            self._client.spin(max(min(timer.next for timer in every) - time.monotonic(), 0.001))

    def close(self) -> None:
        """Release the sticks, leave the graph, and stop the server."""
        with ExitStack() as stack:
            stack.callback(self._server.stop)
            stack.callback(self._listener.close)
            self._operator.leave()

    def _show(self, *, plot: bool) -> None:
        snapshot = self._listener.poll()
        with self._server.atomic():
            if snapshot is not None:
                self._world.visible = True
                self._world.position = (*(-snapshot.q[:2] if self._controls.follow else (0.0, 0.0)), 0.0)
                self.robot.show(snapshot.q)
                state = self._balance.show(snapshot)
            if self._map_due.due(time.monotonic()) and (unreadable := self._ground.show()):
                self._controls.report(unreadable)
        if not plot:
            return
        words = self._listener.words()
        self._waiting.text, self._waiting.visible = words.waiting, bool(words.waiting)
        self._controls.show(snapshot, words)
        if snapshot is not None:
            self._plots.add(snapshot, words)
            self._flat.content = self._balance.flat(self.robot, snapshot, state)


def view(
    *,
    robot: str = "",
    host: str = "127.0.0.1",
    port: int = 8080,
    network: bool = False,
    namespace: str = "",
    signer: Signer | None = None,
    say: Callable[[str], object] = print,
) -> None:
    """Serve the page of the running robot until Ctrl-C; ``PoiseError`` without a robot or if the port is in use."""
    stop = Stop()
    with Client(network=network, namespace=namespace) as client:
        model = RobotModel.load(robot or client.robot(timeout=10.0))
        page = Page(model, client, host=host, port=port, signer=signer)
        try:
            say(f"{page.url} shows {model.name}; Ctrl-C ends it")
            sys.stdout.flush()  # the link is printed only here
            if page.robot.missing:
                say(f"meshes that cannot be read are left out: {', '.join(page.robot.missing)}")
            page.run(lambda: stop.requested)
        finally:
            page.close()
