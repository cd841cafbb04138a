"""Black box of the control process: filled after each command, written by a thread after the robot is damped."""

import threading
import time
from typing import Any

from std_msgs.msg import String

from controllers.recording.black_box import BlackBox, BlackBoxConfig
from controllers.recording.black_box_file import BlackBoxFolder
from controllers.safety.supervisor import ACTIVE_MODES
from controllers.stack import ControlStack
from models.config import default_config
from models.errors import PoiseError
from models.nodes import realtime, topics
from models.nodes.base import PoiseNode
from models.nodes.parameters import declare_config
from models.nodes.qos import LATCHED
from models.nodes.status import subscribe_status
from models.status import SupervisorStatus
from models.types import Mode, SensorData


class BlackBoxKeeper:
    """Fills the ring buffer, and writes it to a file when the mode changes from an active one to damp.

    Mode off follows an active mode only in a deliberate reset, without a file. The file is also written when the
    drivers damp by themselves, with or without a supervisor. The reason in the file includes the faults of the
    supervisor's status, which is received only until the file is written because it costs tick time. Failures are
    counted and reported in the diagnostics. A file can be replayed if ``stack`` logs its inputs.
    """

    def __init__(self, node: PoiseNode, stack: ControlStack) -> None:
        self._node, self._stack = node, stack
        self._config = declare_config(node, default_config(BlackBoxConfig, "controllers", "black_box"), "black_box.")
        self._box: BlackBox | None = None
        self._mode = Mode.OFF
        self._drivers = ""
        self._t = 0.0
        self._armed = False
        self._due: float | None = None
        self._reason = self._faults = ""
        self._subscription: Any = None
        self._thread: threading.Thread | None = None
        self._outcome: tuple[bool, str] | None = None

    def configure(self) -> None:
        """Create the ring buffer and subscribe to the state of the drivers."""
        self._box = BlackBox(self._node.model, self._config, self._stack)
        self._armed, self._due = False, None
        self._node.listen(String, topics.DRIVER_STATE, self._on_driver_state, LATCHED)

    def add(self, sensors: SensorData | None, mode: Mode, stamp: int) -> None:
        """Record a tick with its stamp [ns] after the command, and copy the state of the stack when due.

        ``sensors`` are the raw samples; None when the estimator runs in another process.
        """
        box, stack = self._box, self._stack
        if box is None:
            return
        self._t = stack.state.t
        if mode is not self._mode:
            self._enter(mode)
        result = None if stack.scheduled is None else stack.result
        box.add(stack.state, sensors, result, mode, stamp)
        if result is not None:
            box.checkpoint()

    def _enter(self, mode: Mode) -> None:
        self._mode = mode
        self._note(f"mode {mode.value}")
        if mode is Mode.DAMP:
            self._request_file(f"mode {mode.value}")
        else:
            self._armed = mode in ACTIVE_MODES

    def _on_driver_state(self, message: String) -> None:
        before, self._drivers = self._drivers, message.data[:32]
        self._note(f"drivers {self._drivers}")
        if before == topics.ACTIVE and self._drivers in (topics.DAMPED, topics.OFF):
            self._request_file(f"drivers {self._drivers}")

    def _note(self, text: str) -> None:
        if self._box is not None:
            self._box.event(self._t, text)

    def _request_file(self, reason: str) -> None:
        """Schedule the file for the time ``after`` from now, once per period in active modes."""
        if self._armed:
            self._armed, self._reason, self._faults = False, reason, ""
            self._unsubscribe()
            self._due = time.monotonic() + self._config.after
            self._subscription = subscribe_status(
                self._node, SupervisorStatus, topics.SUPERVISOR_STATUS, self._on_supervisor, LATCHED
            )

    def _on_supervisor(self, status: SupervisorStatus) -> None:
        if status.faults and not self._faults:
            self._faults = "; ".join(status.faults)[:1000]
            self._note(f"supervisor: {self._faults}")

    def _unsubscribe(self) -> None:
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def poll(self) -> None:
        """Start writing when due and report the outcome; called with the diagnostics, never within a tick."""
        if self._thread is not None and not self._thread.is_alive():
            self._thread = None
            self._report()
        if self._due is not None and self._thread is None and time.monotonic() >= self._due:
            self._begin()

    def flush(self) -> None:
        """Write a due file and wait for it, before the node stops."""
        if self._due is not None and self._thread is None:
            self._begin()
        if self._thread is not None:
            self._thread.join()
            self.poll()

    def _begin(self) -> None:
        box, self._due = self._box, None
        self._unsubscribe()
        if box is None:
            return
        box.sealed = True
        reason = f"{self._reason}; supervisor: {self._faults}" if self._faults else self._reason
        self._thread = threading.Thread(target=self._write, args=(box, reason), name="black_box")
        self._thread.start()

    def _write(self, box: BlackBox, reason: str) -> None:
        """Body of the thread; it writes only the outcome to this object."""
        try:
            realtime.be_ordinary()  # no real-time priority for this thread: a disk has no deadline
            name = ".".join([self._node.model.name, *filter(None, self._node.get_namespace().split("/"))])
            folder = BlackBoxFolder(name, self._config.folder, self._config.keep)
            self._outcome = True, str(folder.save(box.record(reason)))
        except (PoiseError, OSError, MemoryError) as error:
            self._outcome = False, str(error)
        finally:
            box.sealed = False

    def _report(self) -> None:
        outcome, self._outcome = self._outcome, None
        written, text = outcome or (False, "the writing thread failed")
        self._node.values["black box"] = text
        if written:
            self._node.get_logger().info(f"black box written: {text}")
        else:
            self._node.counters["black boxes not written"] += 1
            self._node.get_logger().error(text)
