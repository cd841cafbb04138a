"""Process ``damping_guard``: publishes damping commands when the driver is silent.

    python -m bridge.nodes.damping_guard PLANT ROBOT DOMAIN OPTIONS

The attribute ``guard_process`` of the plant's class names the function that creates the guard and its connection. The
process is not a node of the graph; it has a separate connection to the robot. It outlives the driver and the launcher:
after SIGTERM, SIGINT or the end of its launcher, an armed guard stays until the driver has been silent for
``guard_time``. Without its heartbeats the driver holds the robot, and the launcher replaces the guard.
"""

import os
import queue
import signal
import sys
import time
from contextlib import suppress
from threading import Thread

from bridge.plants.base import find_guard
from bridge.plants.config import read_options
from bridge.plants.hardware import real_robot
from bridge.ros.heartbeat import beat
from models.errors import ConfigError, PoiseError
from models.nodes import realtime
from models.robot_model import RobotModel


class BackgroundLog:
    """Writes to stdout in a separate thread, so that the guard does not wait for a reader."""

    def __init__(self) -> None:
        self._texts: queue.Queue[str] = queue.Queue(maxsize=20)
        Thread(target=self._run, daemon=True).start()

    def write(self, text: str) -> None:
        """Write a line; dropped when the queue is full."""
        with suppress(queue.Full):
            self._texts.put_nowait(f"damping_guard: {text}\n")

    def _run(self) -> None:
        while True:
            text = self._texts.get()
            with suppress(OSError):
                os.write(1, text.encode())  # a stopped terminal would hold the lock of sys.stdout


def main(args: list[str] | None = None) -> None:
    """Watch until SIGTERM, SIGINT or the end of the launcher, and, if armed, for ``guard_time`` of silence after it."""
    plant, robot, domain, options = sys.argv[1:] if args is None else args
    parent = os.getppid()
    try:
        if (connect := find_guard(plant)) is None:
            raise ConfigError(f"plant '{plant}' has no guard_process")
        guard, link = connect(RobotModel.load(robot), int(domain), read_options(options))
    except PoiseError as error:
        sys.exit(f"damping_guard: {error}")
    ending: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, _: ending.append(number))
    config = real_robot()
    log = BackgroundLog()
    realtime.use_fifo(config.guard_priority, log.write)
    due = time.monotonic()
    reported = ignored = limit = (
        0  # reported interventions; foreign commands before arming; further ones without a report
    )
    try:
        while True:
            now = time.monotonic()
            for data in link.take():
                guard.receive(data, now)
            if guard.beat_due(now):
                link.beat(guard.armed)
                beat()
            command = guard.step(now)
            if command is not None:
                link.send(command)
            if guard.interventions > reported:
                reported = guard.interventions
                log.write("damping until the end" if ending else "no commands of the driver: damping")
            if not guard.armed:
                ignored = guard.foreign
            elif guard.foreign - ignored > limit:
                log.write(f"another program commands the robot: {guard.foreign - ignored} commands")
                limit = 10 * (guard.foreign - ignored)
            ended = bool(ending) or os.getppid() != parent
            if ended and (not guard.armed or guard.silence(now) > config.guard_time):
                if guard.armed and (final := guard.final_command()) is not None:
                    link.send(final)
                return
            due = max(due + config.command_period, now)
            time.sleep(max(due - time.monotonic(), 0.0))
    finally:
        link.close()


if __name__ == "__main__":
    main()
