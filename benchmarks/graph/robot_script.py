"""One script for a robot behind Unitree's SDK and for the simulated plant: stand, wave, pushes, a walk and a stop.

    python -m benchmarks.graph.robot_script FOLDER RUN

RUN is a ``Run`` in JSON. The results, ``Measured`` as JSON, are the last line of the output. With ``sdk`` it runs in a
network namespace, that of ``benchmarks.core.cable.isolation``: the graph is on one machine of a virtual cable, and the
robot, Unitree's SDK around MuJoCo, on the other.
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

OPERATOR = 20  #: SCHED_FIFO of this process, which publishes velocities, below the graph; where permitted
GRAPH_DOMAIN = 7  #: ROS domain of the graph in its own network; the SDK's robot is in domain 0
STOPPED_TYPE = 4  #: mode_machine of another robot damps at once, as a button does: the SDK's LowState has no buttons


@schema(frozen=True, slots=True, config=STRICT)
class Script:
    """What the robot does, in this order."""

    stand_time: Positive  # [s]
    motion: str
    impulse: NonNegative  # of each push at the base [N.s]
    push_time: Positive  # [s]
    pushes: NonNegativeInt  # number: to the left, right, front, back
    push_pause: Positive  # after each push [s]
    pause: Positive  # after the start, the motion and the walk [s]
    speed: Positive  # of the walk [m/s]
    walk_time: Positive  # [s]


@schema(frozen=True, slots=True, config=STRICT)
class Run:
    """A script on one robot."""

    script: Script
    sdk: bool  # whether it is behind Unitree's SDK
    robot: str = "g1"  # profile of the simulated robot
    seed: NonNegativeInt = 0
    rate: Count = 500  # of states and commands over the protocol [Hz]
    speed: Positive = 1.0  # of the robot's time over real time [-]
    deviation: dict[str, Any] = field(default_factory=dict)  # ``bridge.plants.deviation.Deviation`` of the robot


@dataclass
class Measured:
    """Results so far; ``failure`` says why the script ended early."""

    phase: str = "start"
    failure: str = ""
    drift: list[float] | None = None  # of the standing robot from begin to end, each axis [m]
    stood: float = 0.0  # time of that [s]
    pushes: list[bool] = field(default_factory=list)  # whether it stands after each
    walked: list[float] | None = None  # displacement by the walk: along the heading at its beginning, to the left [m]
    odometry: list[float] | None = None  # the same as it is estimated, along the estimated heading [m]
    stop_ms: int | None = None  # from the stop of the robot to the first damping command, in the robot's time [ms]
    stopped: str = ""  # reason that the driver reports
    kp: float = 0.0  # largest stiffness afterwards [N.m/rad]
    kd: float = 0.0  # largest damping afterwards [N.m.s/rad]
    answer_ms: dict[str, float] = field(default_factory=dict)  # from a sample at the driver to its command [ms]
    stalls: int = 0  # times for which the robot's side waited for this machine


def drive(session: Session, script: Script, found: Measured) -> None:
    """Stand, motion, pushes and walk; ``PoiseError`` when the robot no longer stands."""
    found.phase = "stand"
    session.stand()
    # An operator's computer is another one. The graph restarts its processes from this one.
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
    """Damp the robot by a fault of its side, and measure the reaction."""
    found.phase = "stop"
    found.answer_ms = {name: session.number(key) for name, key in ANSWER_VALUES.items()}
    session.robot("stop", "set", "mode_machine", STOPPED_TYPE)
    session.reach("damped")
    found.stopped = session.waits_for
    session.pass_time(0.5)
    report = session.robot("report")
    found.stop_ms, found.kp, found.kd, found.stalls = (report[key] for key in ("stop_ms", "kp", "kd", "stalls"))


def run(given: Run, folder: Path) -> Measured:
    """Run the script; a robot that does not come through it is one of the results."""
    found = Measured()
    with ExitStack() as stack:
        if given.sdk:
            session: Session = HardwareSession(
                "sdk", folder, given.robot, given.rate, given.speed, given.seed, json.dumps(given.deviation),
                graph_domain=GRAPH_DOMAIN, interface="cable0", robot_interface="cable1", robot=given.robot,
                rate=given.rate, plant_options="{remote: false}", command=stack.enter_context(two_machines()),
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
    """Run what the arguments say and print the results."""
    found = run(parse_config(Run, json.loads(text), "robot_script"), Path(folder))
    print(json.dumps(asdict(found)))


if __name__ == "__main__":
    main(*sys.argv[1:])
