"""Script for a robot behind Unitree's SDK and for the simulated plant: stand, wave, pushes, walk and stop.

    python -m benchmarks.graph.robot_script FOLDER RUN

RUN is a ``Run`` in JSON. The last line of the output is the result, ``Measured`` as JSON. With ``sdk`` the script must
run inside ``benchmarks.core.cable.isolation``: the graph is on one machine of a virtual cable, and the robot, Unitree's
SDK around MuJoCo, on the other.
"""

import json
import sys
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import NonNegativeInt
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.cable import two_machines
from benchmarks.graph.robot_session import HardwareSession, Session, SimulatedSession
from bridge.driver.probes import ANSWER_VALUES
from bridge.ros.environment import free_domain
from models.config import STRICT, Count, NonNegative, Positive, parse_config
from models.errors import PoiseError
from models.nodes.realtime import use_fifo

OPERATOR = 20  #: SCHED_FIFO priority of this process, below the graph, where permitted; it publishes velocities
GRAPH_DOMAIN = 7  #: ROS domain of the graph in a separate network; the SDK's robot is in domain 0
STOPPED_TYPE = 4  #: mode_machine of another robot: damps immediately, like a button, which the SDK's LowState lacks


@schema(frozen=True, slots=True, config=STRICT)
class Script:
    """Actions of the robot, in this order."""

    stand_time: Positive  # [s]
    motion: str
    impulse: NonNegative  # impulse of each push at the base [N.s]
    push_time: Positive  # [s]
    pushes: NonNegativeInt  # number of pushes: to the left, right, front, back
    push_pause: Positive  # pause after each push [s]
    pause: Positive  # pause after the start, the motion and the walk [s]
    speed: Positive  # speed of the walk [m/s]
    walk_time: Positive  # [s]


@schema(frozen=True, slots=True, config=STRICT)
class Run:
    """Script on one robot."""

    script: Script
    sdk: bool  # whether the robot is behind Unitree's SDK
    robot: str = "g1"  # profile of the simulated robot
    seed: NonNegativeInt = 0
    rate: Count = 500  # rate of states and commands of the protocol [Hz]
    speed: Positive = 1.0  # speed of the robot's time over real time [-]
    deviation: dict[str, Any] = field(default_factory=dict)  # ``bridge.plants.deviation.Deviation`` of the robot


@dataclass
class Measured:
    """Results so far; ``failure`` is the reason of an early end."""

    phase: str = "start"
    failure: str = ""
    drift: list[float] | None = None  # displacement while standing, each axis [m]
    stood: float = 0.0  # duration of the standing [s]
    pushes: list[bool] = field(default_factory=list)  # whether the robot stands after each push
    walked: list[float] | None = None  # true displacement by the walk: along the initial heading, to the left [m]
    odometry: list[float] | None = None  # estimated displacement, along the estimated initial heading [m]
    stop_ms: int | None = None  # from the stop of the robot to the first damping command, in robot time [ms]
    stopped: str = ""  # reason reported by the driver
    kp: float = 0.0  # largest stiffness after the stop [N.m/rad]
    kd: float = 0.0  # largest damping after the stop [N.m.s/rad]
    answer_ms: dict[str, float] = field(default_factory=dict)  # from a sample at the driver to its command [ms]
    stalls: int = 0  # number of waits of the robot side for this machine


def drive(session: Session, script: Script, found: Measured) -> None:
    """Run stand, motion, pushes and walk; ``PoiseError`` when the robot no longer stands."""
    found.phase = "stand"
    session.stand()
    # An operator uses another computer. The graph restarts its processes from this process.
    use_fifo(OPERATOR, lambda text: print(text, file=sys.stderr), inherited=False)
    session.pass_time(script.pause)
    begin = session.t
    found.drift = session.drift(script.stand_time).tolist()
    found.stood = session.t - begin
    found.phase = "motion"
    session.send(script.motion)
    session.pass_time(script.pause)
    found.phase = "pushes"
    for x, y in ((0, 1), (0, -1), (1, 0), (-1, 0))[: script.pushes]:
        session.push(np.array([x, y, 0]) * script.impulse / script.push_time, script.push_time)
        session.pass_time(script.push_time + script.push_pause)
        found.pushes.append(session.graph.standing)
    found.phase = "walk"
    walked, estimated = session.walk(script.speed, script.walk_time, script.pause)
    found.walked, found.odometry = walked.tolist(), estimated.tolist()
    if not session.graph.standing:
        raise PoiseError(f"mode '{session.graph.mode}', drivers '{session.graph.driver_state}' after the walk")


def stop(session: HardwareSession, found: Measured) -> None:
    """Damp the robot by a fault of its side and measure the reaction."""
    found.phase = "stop"
    found.answer_ms = {name: session.number(key) for name, key in ANSWER_VALUES.items()}
    session.robot("stop", "set", "mode_machine", STOPPED_TYPE)
    session.reach("damped")
    found.stopped = session.waits_for
    session.pass_time(0.5)
    report = session.robot("report")
    found.stop_ms, found.kp, found.kd, found.stalls = (report[key] for key in ("stop_ms", "kp", "kd", "stalls"))


def run(given: Run, folder: Path) -> Measured:
    """Run the script; a failure of the robot is one of the results."""
    found = Measured()
    with ExitStack() as stack:
        if given.sdk:
            session: Session = HardwareSession(
                "sdk", folder, given.robot, given.rate, given.speed, given.seed, json.dumps(given.deviation),
                graph_domain=GRAPH_DOMAIN, interface="cable0", robot_interface="cable1", robot=given.robot,
                rate=given.rate, plant_options=f"{{remote: false, speed: {given.speed}}}",
                command=stack.enter_context(two_machines()),
            )  # fmt: skip
        else:
            session = SimulatedSession(
                given.robot, folder, domain=free_domain(), seed=given.seed, speed=given.speed,
                push_time=given.script.push_time,
            )  # fmt: skip
        stack.enter_context(session)
        try:
            drive(session, given.script, found)
            if isinstance(session, HardwareSession):
                stop(session, found)
        except PoiseError as error:
            reason = session.waits_for if isinstance(session, HardwareSession) else ""
            found.failure = "; ".join(filter(None, (str(error), reason)))
    return found


def main(folder: str, text: str) -> None:
    """Run the script given by the arguments and print the results."""
    found = run(parse_config(Run, json.loads(text), "robot_script"), Path(folder))
    print(json.dumps(asdict(found)))


if __name__ == "__main__":
    main(*sys.argv[1:])
