"""Random commands to one and two robots while other programs keep every core busy: slower, but no fall.

The issue's hour, with the histogram of the real-time factor printed:

    POISE_BUSY_SECONDS=3600 .venv/bin/python -m pytest -q -s -m slow tests/ros/graph/test_busy_machine.py -k one
"""

import multiprocessing
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from std_msgs.msg import Float64, String

from bridge.launch.graph import Graph
from bridge.ros.environment import free_domain
from models.nodes import topics
from models.nodes.odometry import OdometryCodec, velocity_to_twist
from models.nodes.qos import COMMAND, EVENT, LATCHED, SENSOR

pytestmark = [pytest.mark.ros, pytest.mark.slow]

SECONDS = float(os.environ.get("POISE_BUSY_SECONDS", "120"))
WORDS = ("wave", "squat", "stand", "stop", "forward", "back", "left", "right", "spin", "walk", "fly", "x" * 10_000)
FASTEST = np.array([0.5, 0.2, 0.5])  #: Of the random velocities: forward, left [m/s], turn [rad/s]
PAUSE = (0.5, 4.0)  #: Between two commands [s]


@dataclass
class Record:
    """What happened to one robot."""

    lowest: float = np.inf  # height of the base [m]
    robot_time: float = 0.0  # [s]
    distance: float = 0.0  # walked [m]
    modes: Counter[str] = field(default_factory=Counter)
    sent: Counter[str] = field(default_factory=Counter)
    factors: list[float] = field(default_factory=list)


@pytest.fixture
def busy() -> Iterator[None]:
    """Two programs that never rest, each in a separate session, so that each gets a whole share of the cores."""
    command = [sys.executable, "-c", "while True: pass"]
    programs = [subprocess.Popen(command, start_new_session=True) for _ in range(2)]
    yield
    for program in programs:
        program.kill()
        program.wait()


def command_at_random(seed: int, seconds: float, domain: int, log: Path) -> Record:
    """Send random words and velocities to a robot for a time [s]."""
    record, rng = Record(), np.random.default_rng(seed)
    codec, last = OdometryCodec(), np.full(2, np.nan)
    with Graph("g1", domain_id=domain, log=log, say=lambda text: None) as graph:

        def on_truth(data: bytes) -> None:
            nonlocal last
            stamp, pose, _ = codec.decode(data)
            record.robot_time = stamp * 1e-9
            record.lowest = min(record.lowest, pose[2])
            moved = np.linalg.norm(pose[:2] - last)
            if not moved < 0.05:
                record.distance += 0.0 if np.isnan(moved) else float(moved)
                last = pose[:2].copy()

        listen = graph.node.create_subscription
        velocities = graph.node.create_publisher(Twist, topics.CMD_VEL, COMMAND)
        graph.wait_standing(300.0)
        listen(Odometry, topics.GROUND_TRUTH, on_truth, SENSOR, raw=True)
        listen(Float64, topics.REAL_TIME_FACTOR, lambda message: record.factors.append(message.data), LATCHED)
        listen(String, topics.MODE, lambda message: record.modes.update([message.data]), EVENT)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            assert graph.driver_state == topics.ACTIVE, f"{graph.driver_state} after {record}"
            if rng.random() < 0.5:
                word = str(rng.choice(WORDS))
                record.sent[word[:8]] += 1
                graph.send(word)
                graph.spin(rng.uniform(*PAUSE))
                continue
            velocity = rng.uniform(-FASTEST, FASTEST)
            record.sent["velocity"] += 1
            until = time.monotonic() + rng.uniform(*PAUSE)
            while time.monotonic() < until:
                velocities.publish(velocity_to_twist(velocity))
                graph.spin(0.05)
            velocities.publish(Twist())
    return record


def report(record: Record) -> None:
    """Print what happened, and the histogram of the real-time factor."""
    factors = np.array(record.factors)
    counts, edges = np.histogram(factors, bins=np.linspace(0.0, 1.1, 12))
    print(f"\nlowest {record.lowest:.3f} m, {record.robot_time:.0f} s of the robot, walked {record.distance:.0f} m")
    print(f"sent {dict(record.sent)}, modes {dict(record.modes)}")
    print(f"real-time factor: median {np.median(factors):.2f}, least {factors.min():.2f}")
    for low, high, count in zip(edges, edges[1:], counts, strict=False):
        print(f"{low:4.1f} to {high:3.1f} {count:6d} {'#' * round(60 * count / len(factors))}")


def check(record: Record) -> None:
    """It never fell, and did something."""
    report(record)
    assert record.lowest > 0.5  # [m]; 0.78 standing, 0.5 in the deepest squat
    assert record.modes["walk"] > 0
    assert record.distance > 0.5


def test_one_robot_beside_two_busy_programs(tmp_path: Path, busy: None) -> None:
    check(command_at_random(1, SECONDS, free_domain(), tmp_path / "log"))


def test_two_robots_beside_two_busy_programs(tmp_path: Path, busy: None) -> None:
    spawned = multiprocessing.get_context("spawn")
    with spawned.Pool(2) as pool:
        given: list[Any] = [(seed, SECONDS, 60 + seed, tmp_path / f"log{seed}") for seed in (2, 3)]
        for record in pool.starmap(command_at_random, given):
            check(record)
