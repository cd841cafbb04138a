"""``poise view``: a page in the browser that shows a running robot and steers it."""

import socket
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import viser
from rcl_interfaces.msg import ParameterType
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

from bridge.ros.client import Client
from bridge.ros.operator import Operator
from bridge.view.controls import Controls, LivePlots
from bridge.view.listener import Listener, ViewConfig
from bridge.view.scene import WORLD, BalanceScene, RobotScene
from controllers.commands.command_signature import Signer
from controllers.safety.health import SupervisorConfig
from models.config import default_config
from models.errors import PoiseError
from models.nodes.spin import Stop
from models.robot_model import RobotModel
from planners.gait.config import load_gait_config

STEPS = 200  #: Positions of a slider [-]
REACH = 4.0  #: Upper end of a slider as a multiple of its first value, within the parameter's range [-]
USUAL = "whole_body."  #: Common prefix of names, omitted from the short labels


class Gains:
    """A slider for each float parameter of a node that is not read-only and has a range.

    A refused value is reported with its reason, and the slider goes back. Requests are repeated after ``timeout`` [s].
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
        """Set a value on the node; when it refuses the newest one, the slider goes back."""
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
        """Continue with an answer, or report why there is none."""

        def done(future: Any) -> None:
            error = future.exception()
            if error is None:
                go_on(future.result())
            else:
                self._report(f"parameters of {self._node}: {error}")

        future.add_done_callback(done)


CAMERA = ((2.2, -1.6, 1.4), (0.0, 0.0, 0.6))  #: Position and target of the first view, for a robot at the origin [m]
TUNED = "balance_controller"  #: Node whose gains get sliders


class Page:
    """The page of one robot at ``url``, unsigned without ``signer``; ``PoiseError`` when the port is in use."""

    def __init__(
        self, model: RobotModel, client: Client, *, host: str, port: int, signer: Signer | None = None
    ) -> None:
        self._client, self._config = client, default_config(ViewConfig, "bridge", "view")
        self._server = _serve(host, port, model.name)
        self.url = f"http://{'localhost' if host == '0.0.0.0' else host}:{self._server.get_port()}"
        gui, scene = self._server.gui, self._server.scene
        self._world = scene.add_frame(WORLD, show_axes=False)
        scene.add_grid(f"{WORLD}/floor", width=40.0, height=40.0, cell_size=0.25, section_size=1.0)
        self._listener = Listener(model, client)
        self.robot = RobotScene(scene, model)
        self._balance = BalanceScene(scene, model, self._config)
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
        """Show and steer until ``stop`` returns True."""
        next_picture = next_plot = next_drive = time.monotonic()
        while not stop():
            self._operator.do_posted()
            now = time.monotonic()
            browsers = self._server.get_clients()
            if now >= next_drive:
                next_drive = now + 1.0 / self._config.drive_rate
                self._operator.drive(self._controls.sticks.velocity(browsers))
            if now >= next_picture:
                next_picture = now + 1.0 / self._config.rate
                plot = now >= next_plot
                if browsers:
                    self._show(plot=plot)
                if plot:
                    next_plot = now + 1.0 / self._config.plot_rate
                    self._gains.ask()
            self._client.spin(max(min(next_picture, next_drive) - time.monotonic(), 0.001))

    def close(self) -> None:
        """Release the sticks, leave the graph, and end the server."""
        with ExitStack() as stack:
            stack.callback(self._server.stop)
            stack.callback(self._listener.close)
            self._operator.drive(None)

    def _show(self, *, plot: bool) -> None:
        snapshot = self._listener.poll()
        if snapshot is None:
            return
        with self._server.atomic():
            self._world.position = (*(-snapshot.q[:2] if self._controls.follow else (0.0, 0.0)), 0.0)
            self.robot.show(snapshot.q)
            self._balance.show(snapshot)
            if plot:
                words = self._listener.words()
                self._controls.show(snapshot, words)
                self._plots.add(snapshot, words)


def view(
    *,
    robot: str = "",
    host: str = "127.0.0.1",
    port: int = 8080,
    network: bool = False,
    namespace: str = "",
    signer: Signer | None = None,
    say: Callable[[str], object] = print,
    timeout: float = 10.0,
) -> None:
    """Serve the page of the running robot until Ctrl-C; ``PoiseError`` without a robot or where the port is in use."""
    stop = Stop()
    with Client(network=network, namespace=namespace) as client:
        model = RobotModel.load(robot or client.robot(timeout))
        page = Page(model, client, host=host, port=port, signer=signer)
        try:
            say(f"{page.url} shows {model.name}; Ctrl-C ends it")
            if page.robot.missing:
                say(f"meshes that cannot be read are left out: {', '.join(page.robot.missing)}")
            page.run(lambda: stop.requested)
        finally:
            page.close()


def _serve(host: str, port: int, robot: str) -> Any:
    """Start viser's server; ``PoiseError`` when the port is in use, where viser would silently take the next one."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise PoiseError(f"{host}:{port} cannot be listened on: {error.strerror}; choose another --port") from error
    server = viser.ViserServer(host=host, port=port, label=f"poise: {robot}", verbose=False)
    server.scene.set_up_direction("+z")
    server.initial_camera.position, server.initial_camera.look_at = CAMERA
    return server
