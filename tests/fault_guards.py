"""The guard behind each row of ``poise bench faults``, and how to take it away, it alone."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
from msgspec import structs

from bridge import calibrating, closed_loop
from controllers import stack
from controllers.commands import command_signature
from controllers.commands.arbitration import NO_SOURCE, Arbiter
from controllers.commands.command_signature import VerifiedCommand, Verifier
from controllers.commands.obstacle_stop import ObstacleStop
from controllers.estimation import feet
from controllers.estimation.feet import SensorLimits
from controllers.estimation.samples import STALE, EstimatorHealth, SensorBuffer
from controllers.joints import joint_servo
from controllers.joints.joint_servo import JointServo
from controllers.joints.torque_limiter import TorqueLimits, torque_limits
from controllers.qp.solve import QPSolver
from controllers.safety import joint_monitor, preflight
from controllers.safety.health import SupervisorConfig
from controllers.safety.joint_monitor import JointMonitor
from controllers.safety.supervisor import Supervisor
from controllers.stack import ControlStack
from controllers.whole_body.controller import WholeBodyController
from models import profile, trajectory
from models.config import default_config
from models.robot_model import RobotModel
from models.types import CommandReply, JointCommand, Mode, SensorData, SolveStatus
from planners.gait.commands import Commands
from planners.gait.contact import AirborneDetector


@dataclass(frozen=True)
class Guard:
    """What keeps a row from failing.

    Attributes:
        away: Owner, name, and what is there instead, once the guard is taken away.
    """

    away: tuple[tuple[Any, str, Any], ...]

    @contextmanager
    def gone(self) -> Iterator[None]:
        """Without it."""
        with ExitStack() as stack:
            for owner, name, instead in self.away:
                stack.enter_context(patch.object(owner, name, instead))
            yield


def _of(owner: Any, name: str, instead: Any) -> Guard:
    return Guard(((owner, name, instead),))


def _both(*guards: Guard) -> Guard:
    """Two that do the same: either is enough."""
    return Guard(tuple(away for guard in guards for away in guard.away))


def _always(value: Any) -> Callable[..., Any]:
    return lambda *arguments, **named: value


def _supervisor(**changes: Any) -> Guard:
    config = replace(default_config(SupervisorConfig, "controllers", "supervisor"), **changes)
    return _of(stack, "Supervisor", lambda model, gait: Supervisor(model, config, gait=gait))


_accept = SensorBuffer.accept


def _take_everything(self: SensorBuffer, sensors: SensorData) -> int:
    missing, memory = _accept(self, sensors), self.memory
    memory.joints[:], memory.imu[:], memory.wrenches[:] = memory.new_joints, memory.new_imu, memory.new_wrenches
    memory.feet[:] = 0.0
    return missing & STALE


def _take_full_scale(self: SensorBuffer, sensors: SensorData) -> int:
    self.memory.scales[:] = np.inf
    return _accept(self, sensors)


def _count_no_drop_out(self: EstimatorHealth, missing: int, dt: float) -> None:
    self.coasting = 0.0


def _believe_the_sensors(**limits: float) -> SensorLimits:
    return SensorLimits(**(limits | dict.fromkeys(("load_error", "contact_error", "fault_time"), np.inf)))


def _damp_at_once(self: WholeBodyController) -> tuple[JointCommand, SolveStatus]:
    zero = np.zeros(self.model.nj)
    return JointCommand(self._joints.copy(), zero, zero), SolveStatus.DAMPED


def _repeat_for_ever(self: WholeBodyController) -> tuple[JointCommand, SolveStatus]:
    assert self._last is not None
    return self._last, SolveStatus.HELD


def _at_any_rate(model: RobotModel, *margins: float) -> TorqueLimits:
    return torque_limits(model, *margins)._replace(rate=np.full(model.nj, np.inf))


def _fault_without_latch(self: Supervisor, reason: str, *severity: Any) -> CommandReply:
    return self._enter(Mode.DAMP, reason)


_text = Supervisor.text

_start_motion = Supervisor._start_motion


def _never_busy(self: Supervisor, name: str) -> CommandReply:
    self.motion, self.mode = None, Mode.STAND
    return _start_motion(self, name)


_parse = profile.parse_config

MONITOR = _of(JointMonitor, "step", _always(None))
DELAY = _of(joint_monitor, "default_config", lambda *name: replace(default_config(*name), delay=0.003))
DRIVERS = _of(JointServo, "overdue", _always(False))
COASTING = _of(EstimatorHealth, "count", _count_no_drop_out)
TILT = _of(stack, "tilt", _always(0.0))
FINITE = _of(SensorBuffer, "accept", _take_everything)
STAMPS = _of(SensorBuffer, "_goes_on", lambda self, t: True)
FEET = _of(feet, "SensorLimits", _believe_the_sensors)
NO_TORQUES = _of(WholeBodyController, "fall_back", _repeat_for_ever)
WALK = _of(Supervisor, "_walk", lambda self: self._enter(Mode.WALK, "at once"))
NAMES = _of(trajectory, "_check_names", lambda traj, model: np.arange(model.nj))
TIMES = _of(trajectory._Check, "times", _always(None))
POINTS = _of(trajectory._Check, "points", _always(None))
SHAPES = _of(trajectory._Check, "shapes", _always(None))
SCHEMA = _of(
    profile,
    "parse_config",
    lambda schema, data, source: _parse(schema, profile.read_yaml(profile._robots_folder() / "g1.yaml"), source),
)

GUARDS: dict[str, Guard] = {
    "joints_out_40ms": DRIVERS,
    "joints_out_200ms": DRIVERS,
    "joints_nan": COASTING,
    "joints_inf": COASTING,
    "joints_nan_2ms": FINITE,
    "encoder_stuck": MONITOR,
    "encoder_stuck_walk": MONITOR,
    "joints_late_20ms_walk": DELAY,
    "stamps_repeated": COASTING,
    "stamps_old": COASTING,
    "stamps_old_10ms": STAMPS,
    "stamp_in_the_future": _of(SensorBuffer, "_goes_on", lambda self, t: self.t < t),
    "gyro_saturated": _of(SensorBuffer, "accept", _take_full_scale),
    "imu_out_20ms": FINITE,
    "imu_out_20ms_walk": FINITE,
    "imu_out_100ms": COASTING,
    "imu_nan": COASTING,
    "imu_nan_2ms": FINITE,
    "imu_flipped": _of(preflight, "attitude", _always([])),
    "foot_stuck_off_walk": FEET,
    "knee_dead": MONITOR,
    "knee_dead_walk": MONITOR,
    "qp_infeasible": _of(QPSolver, "_relaxed", _always((None, np.nan))),
    "qp_nan_1_tick": _of(WholeBodyController, "fall_back", _damp_at_once),
    "qp_nan": NO_TORQUES,
    "torque_nan": DRIVERS,
    "text_of_1_mb": _of(Supervisor, "text", lambda self, command: _text(self, command[:100])),
    "text_unknown": _supervisor(motions=("squat", "fly")),
    "stand_while_walking": _of(ControlStack, "gait_active", False),
    "squat_while_walking": _supervisor(walking_motions=("wave", "squat")),
    "calibrate_walking": _of(calibrating, "Mode", SimpleNamespace(STAND=Mode.WALK)),
    "second_motion": _of(Supervisor, "_start_motion", _never_busy),
    "walk_while_squatting": WALK,
    "walk_while_damped": WALK,
    "stand_while_fallen": _of(Supervisor, "fault", _fault_without_latch),
    "velocity_standing": _of(closed_loop, "Mode", SimpleNamespace(WALK=Mode.STAND)),
    "velocity_nan": _of(
        Commands, "set_velocity", lambda self, state, velocity: structs.replace(state, target=velocity)
    ),
    "unsigned": _of(Verifier, "verify", lambda self, line: VerifiedCommand("teleop", line)),
    "forged": _of(command_signature.hmac, "compare_digest", _always(True)),
    "replayed": _of(Verifier, "_check_stamp", _always(None)),
    "two_commanders": _of(Arbiter, "in_command", _always(NO_SOURCE)),
    "locked_out": _of(Arbiter, "locks", _always(())),
    "trajectory_unknown_joint": _both(
        NAMES,
        _of(RobotModel, "joint_index", lambda self, name: self._index.get(name, 0)),
    ),
    "trajectory_joint_twice": NAMES,
    "trajectory_nan": _of(trajectory._Check, "finite", _always(None)),
    "trajectory_equal_times": TIMES,
    "trajectory_times_back": TIMES,
    "trajectory_past": TIMES,
    "trajectory_begun": TIMES,
    "trajectory_outside": POINTS,
    "trajectory_too_fast": POINTS,
    "trajectory_jump": _of(trajectory._Check, "start", _always(None)),
    "trajectory_empty": SHAPES,
    "trajectory_of_100000": SHAPES,
    "profile_unknown_key": SCHEMA,
    "profile_not_a_number": SCHEMA,
    "urdf_without_a_link": _of(RobotModel, "link_frame_id", lambda self, link, user: 1),
    "urdf_heavier": _of(preflight, "_mass", _always([])),
    "lifted": _of(AirborneDetector, "update", lambda self, airborne, *_: (airborne, False)),
    "obstacle": _of(ObstacleStop, "limit", lambda self, velocity, t: (velocity, "")),
    "fall": _both(TILT, NO_TORQUES),
}
"""By row."""

RATE = _of(joint_servo, "torque_limits", _at_any_rate)
"""Of the drivers' torques, behind every row."""

WITHOUT_GUARD: dict[str, str] = {
    "joints_out_10ms": "the drivers hold the last setpoint",
    "joints_out_10ms_walk": "the drivers hold the last setpoint",
    "encoder_offset": "feedback",
    "joints_half_rate": "feedback",
    "joints_late_5ms": "feedback",
    "joints_late_10ms": "feedback",
    "joints_late_20ms": "feedback",
    "joints_late_10ms_walk": "feedback",
    "joints_lost_1_in_10": "feedback, and setpoints that hold",
    "stamps_repeated_10ms": "missing samples for 10 ms; that they are left out, or taken, is all the same",
    "stamps_late_20ms": "as repeated for 20 ms; what comes then goes on",
    "gyro_bias_ramp": "the filter estimates the bias",
    "foot_stuck_off": "standing, a foot that reads no load stays where it is",
    "foot_nan": "standing, the last reading is about right",
    "foot_stuck_on_walk": "holds even without the check of the sensor: the schedule has the swing foot",
    "foot_nan_walk": "holds even where the last reading is used, likewise",
    "foot_stuck_on": "standing, the last reading is about right",
    "torque_limits_60": "feedback",
    "knee_half": "feedback",
    "torque_nan_1_tick": "two of the drivers: they refuse the setpoint, and limit what is no number to no torque",
    "text_flood": "words are cheap",
    "kicks": "feedback",
    "kicks_walk": "feedback",
    "friction_0_4": "feedback",
    "friction_1_0": "feedback",
    "payload": "feedback",
    "bumps": "feedback",
    "slope": "feedback",
}
"""Rows that hold without a guard, and why."""
