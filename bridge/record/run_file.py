"""Reads a recording of the graph or of the closed loop: samples, commands, motions, and inputs of the laws."""

import struct
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMsg
from zstandard import ZstdError

from bridge.record.mcap_log import DESCRIPTION, EVENTS, ROBOT
from controllers.input_log import TickInputs
from controllers.recording.black_box_file import SUFFIX
from models.constants import FOOT_NAMES
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.messages import (
    ImuCodec,
    JointCommandCodec,
    JointStateCodec,
    WrenchCodec,
    decode,
    trajectory_from_message,
)
from models.nodes.odometry import OdometryCodec
from models.robot_model import SOLE_FRAMES, RobotModel
from models.types import JointCommand, JointTrajectory, Vector

Joints = tuple[int, Vector, Vector, Vector]  #: Sampling stamp [ns], positions, velocities, torques (nj,)


@dataclass(slots=True)
class RecordedRun:
    """Contents of a recording, by the stamp of the tick [ns]."""

    robot: RobotModel
    joints: dict[int, Joints] = field(default_factory=dict)
    imu: dict[int, tuple[Vector, Vector]] = field(default_factory=dict)  #: Rate and specific force (3,)
    #: Wrenches of the left and the right foot (6,)
    feet: tuple[dict[int, Vector], dict[int, Vector]] = field(default_factory=lambda: ({}, {}))
    commands: dict[int, JointCommand] = field(default_factory=dict)  #: Outputs of the laws
    #: Estimated base: pose (7,) and twist in the base frame (6,)
    estimates: dict[int, tuple[Vector, Vector]] = field(default_factory=dict)
    truths: dict[int, tuple[Vector, Vector]] = field(default_factory=dict)  #: True base of the simulator, likewise
    notes: list[TickInputs] = field(default_factory=list)  #: Inputs of the laws
    motions: dict[int, JointTrajectory] = field(default_factory=dict)  #: Trajectories by the CRC-32 of their message
    #: Stamp [ns], topic and text of modes and events, in order
    texts: list[tuple[int, str, str]] = field(default_factory=list)

    @property
    def lost(self) -> int:
        """Number of missing joint samples, from the shortest interval of the stamps."""
        return missing(self.joints)


def missing(stamps: Iterable[int]) -> int:
    """Number of stamps [ns] missing in a sequence; the shortest interval is taken as the period."""
    steps = np.diff(np.unique(np.fromiter(stamps, dtype=np.int64)))
    return int((np.rint(steps / steps.min()) - 1).sum()) if steps.size else 0


def read_run(path: Path, robot: str = "") -> RecordedRun:
    """Read an MCAP file of ``poise record`` or a closed loop; ``robot`` replaces its profile. Raises ``PoiseError``."""
    if path.suffix == SUFFIX:
        raise PoiseError(f"{path}: is a black box, not a recording; use `poise log black-box`")
    try:
        with path.open("rb") as file:
            reader = make_reader(file)
            named = [each.metadata for each in reader.iter_metadata() if each.name == DESCRIPTION]
            name = robot or (named[-1].get(ROBOT, "") if named else "")
            if not name:
                raise PoiseError(f"{path}: does not name its robot; give it with --robot")
            run = RecordedRun(RobotModel.load(name))
            takers = _takers(run)
            summary = reader.get_summary()
            recorded = set() if summary is None else {each.topic.lstrip("/") for each in summary.channels.values()}
            if topics.JOINT_SETPOINTS not in recorded:  # an earlier version used this name for setpoints
                takers[topics.JOINT_TRAJECTORY] = takers[topics.JOINT_SETPOINTS]
            for _, channel, message in reader.iter_messages():
                take = takers.get(channel.topic.lstrip("/"))
                if take is not None:
                    take(message.log_time, bytes(message.data))
            return run
    except OSError as error:
        raise PoiseError(f"{path}: cannot be read: {error.strerror}") from error
    except (McapError, ZstdError, struct.error, ValueError, OverflowError) as error:
        reason = f": {error}" if str(error) else ""
        raise PoiseError(f"{path}: not a recording, or a damaged or incomplete one{reason}") from error


def _takers(run: RecordedRun) -> dict[str, Callable[[int, bytes], object]]:
    joints, commands, imu = JointStateCodec(run.robot), JointCommandCodec(run.robot), ImuCodec(topics.IMU_FRAME)
    odometry = OdometryCodec()

    def take_foot(foot: int) -> Callable[[int, bytes], object]:
        codec, kept = WrenchCodec(SOLE_FRAMES[foot]), run.feet[foot]
        return lambda stamp, data: kept.update({stamp: codec.read(data)[1]})

    def take_command(_: int, data: bytes) -> None:
        stamp, command = commands.decode(data)
        if isinstance(command, JointCommand):
            run.commands[stamp] = command

    def take_base(kept: dict[int, tuple[Vector, Vector]]) -> Callable[[int, bytes], object]:
        def take(_: int, data: bytes) -> None:
            stamp, pose, twist = odometry.decode(data)
            kept[stamp] = pose, twist

        return take

    def take_motion(_: int, data: bytes) -> None:
        run.motions[zlib.crc32(data)] = trajectory_from_message(decode(data, JointTrajectoryMsg))

    def take_text(topic: str) -> Callable[[int, bytes], object]:
        return lambda stamp, data: run.texts.append((stamp, topic, decode(data, String).data))

    return {
        topics.JOINT_STATES: lambda stamp, data: run.joints.update({stamp: joints.read(data)}),
        topics.IMU_RAW: lambda stamp, data: run.imu.update({stamp: imu.read(data)[1:]}),
        **{topics.FOOT_WRENCHES[foot]: take_foot(foot) for foot in range(len(FOOT_NAMES))},
        topics.JOINT_SETPOINTS: take_command,
        topics.ODOM: take_base(run.estimates),
        topics.GROUND_TRUTH: take_base(run.truths),
        topics.APPLIED: lambda _, data: run.notes.append(TickInputs.read(decode(data, String).data)),
        **dict.fromkeys((topics.JOINT_TRAJECTORY, topics.MOTION_TRAJECTORY), take_motion),
        **{topic: take_text(topic) for topic in (topics.MODE, topics.HUMANOID_COMMANDS, EVENTS)},
    }
