"""Commands of an operator: text commands, services, velocities and pushes, all from one loop."""

import queue
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from geometry_msgs.msg import Twist, WrenchStamped
from rclpy.duration import Duration
from std_msgs.msg import String
from std_srvs.srv import Trigger

from bridge.ros.client import Client, signed
from controllers.commands.command_signature import Signer
from models.nodes import topics
from models.nodes.odometry import velocity_to_twist
from models.nodes.qos import COMMAND, EVENT
from models.types import Vector, Velocity

SOURCE = "teleop"  #: Command source of the operator (controllers/config/arbitration.yaml)
LEAVE_TIMEOUT = 1.0  #: Longest wait for the last commands to arrive [s]
#: Services by the buttons that call them
MODE_SERVICES = {
    "stand": "mode/stand",
    "walk": "mode/walk",
    "damp": "mode/damp",
    "E-STOP": "estop",
    "reset faults": "reset_faults",
    "reset robot": "reset",
}


class Operator:
    """Publishers and service clients of an operator: the page of ``poise view``, or ``poise teleop``.

    Callbacks of the page run in threads of the web server. They ``post`` actions, and the loop of the page executes
    them, so that rclpy objects are used from one thread only. ``client`` must be entered. Text commands are unsigned
    when ``signer`` is None. ``report`` is called with every answer; ``services`` are the clients of ``MODE_SERVICES``.
    """

    def __init__(self, client: Client, report: Callable[[str], object], signer: Signer | None = None) -> None:
        self._report, self._signer = report, signer
        words, velocities = topics.source_topics(SOURCE)
        self._words = client.node.create_publisher(String, words, EVENT)
        self._velocities = client.node.create_publisher(Twist, velocities, COMMAND)
        self._pushes = client.node.create_publisher(WrenchStamped, topics.PUSH, EVENT)
        self.services = {name: client.node.create_client(Trigger, service) for name, service in MODE_SERVICES.items()}
        self._posted: queue.SimpleQueue[Callable[[], object]] = queue.SimpleQueue()
        self._driving = False

    def post(self, action: Callable[[], object]) -> None:
        """Queue an action for the loop; may be called from any thread."""
        self._posted.put(action)

    def do_posted(self) -> None:
        """Execute the queued actions."""
        with suppress(queue.Empty):
            while True:
                self._posted.get_nowait()()

    def say(self, text: str) -> None:
        """Publish a text command as ``SOURCE``."""
        self._publish_word(text)
        self._report(f"sent {text}")

    def call(self, name: str) -> None:
        """Call a service of ``MODE_SERVICES``; the answer is reported on arrival."""
        client = self.services[name]
        if not client.service_is_ready():
            self._report(f"{MODE_SERVICES[name]}: the service is not available: is the robot up? (poise up)")
            return
        client.call_async(Trigger.Request()).add_done_callback(lambda future: self._answer(name, future))

    def drive(self, velocity: Velocity | None) -> None:
        """Publish a velocity; None publishes zero once and then nothing, so that other sources can take over."""
        if velocity is not None or self._driving:
            given = velocity or (0.0, 0.0, 0.0)
            if self._signer is None:
                self._velocities.publish(velocity_to_twist(given))
            else:  # a Twist cannot be signed
                self._publish_word("velocity {:.6f} {:.6f} {:.6f}".format(*given))
        self._driving = velocity is not None

    def leave(self) -> None:
        """Publish zero if a velocity was commanded, and wait until it has arrived, as this process may end next."""
        self.drive(None)
        for publisher in (self._velocities, self._words):
            publisher.wait_for_all_acked(Duration(seconds=LEAVE_TIMEOUT))

    def push(self, force: Vector) -> None:
        """Push the base of the simulated robot with a force in W (3,) [N]."""
        message = WrenchStamped()
        message.header.frame_id = topics.BASE_FRAME
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = map(float, np.asarray(force))
        self._pushes.publish(message)
        self._report(f"pushed with {np.linalg.norm(force):.0f} N")

    def _publish_word(self, text: str) -> None:
        self._words.publish(String(data=signed(text, self._signer)))

    def _answer(self, name: str, future: Any) -> None:
        error = future.exception()
        answer = None if error else future.result()
        text = str(error if answer is None else answer.message or answer.success)
        self._report(text if text.startswith(f"{name}: ") else f"{name}: {text}")
