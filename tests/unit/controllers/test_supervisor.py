"""The mode machine: guarded transitions, text commands, the fault latch."""

from dataclasses import replace

import pytest

from controllers.safety.health import Health, Severity, SupervisorConfig, second_publisher
from controllers.safety.supervisor import Supervisor
from models.config import default_config
from models.robot_model import RobotModel
from models.types import Mode, SolveStatus

WELL = Health(state_stamp=1.0, command_stamp=1.0, tilt=0.05)


@pytest.fixture
def law(g1: RobotModel) -> Supervisor:
    supervisor = Supervisor(g1)
    supervisor.set_preflight(())
    return supervisor


@pytest.fixture
def standing(law: Supervisor) -> Supervisor:
    assert law.request(Mode.STAND).accepted
    return law


def test_arming_is_refused_until_preflight_passes(g1: RobotModel) -> None:
    law = Supervisor(g1)
    assert "preflight checks have not run" in law.request(Mode.STAND).reason
    law.set_preflight(("imu/data_raw arrives at 500 Hz instead of 1000 Hz",))
    reply = law.request(Mode.STAND)
    assert not reply.accepted
    assert "imu/data_raw arrives at 500 Hz" in reply.reason
    assert law.mode is Mode.OFF


def test_walk_is_refused_with_the_reason(standing: Supervisor) -> None:
    for reply in (standing.request(Mode.WALK), standing.text("walk"), standing.text("forward")):
        assert not reply.accepted
        assert "no gait planner runs" in reply.reason
    assert standing.mode is Mode.STAND


def test_off_is_refused_while_standing_and_allowed_from_damp(standing: Supervisor) -> None:
    assert "request 'damp' first" in standing.request(Mode.OFF).reason
    assert standing.request(Mode.DAMP).accepted
    assert standing.request(Mode.OFF).accepted


def test_motion_runs_from_request_to_end(standing: Supervisor) -> None:
    assert standing.text("  WAVE ").accepted
    assert standing.mode is Mode.MOTION
    assert standing.take_motion() == "wave"
    assert standing.take_motion() is None
    assert "busy with 'wave'" in standing.text("squat").reason
    assert standing.update(WELL, 1.0) is Mode.MOTION  # still being planned
    assert standing.update(replace(WELL, motion_active=True), 1.01) is Mode.MOTION
    assert standing.update(WELL, 1.02) is Mode.STAND


def test_motion_that_never_starts_is_given_up(standing: Supervisor) -> None:
    standing.text("bow")
    standing.take_motion()
    late = 1.0 + standing.config.plan_timeout + 0.1
    assert standing.update(WELL, 1.0) is Mode.MOTION
    assert standing.update(replace(WELL, state_stamp=late, command_stamp=late), late) is Mode.STAND


def test_refused_motion_returns_to_stand_with_the_reason(standing: Supervisor) -> None:
    standing.text("reach")
    reply = standing.motion_refused("target out of reach")
    assert not reply.accepted
    assert reply.reason == "motion 'reach' refused: target out of reach"
    assert standing.mode is Mode.STAND


def test_stop_holds_the_posture(standing: Supervisor) -> None:
    standing.text("squat")
    standing.take_motion()
    assert standing.text("stop").accepted
    assert standing.mode is Mode.STAND
    assert standing.take_motion() == "stop"


@pytest.mark.parametrize("text", ["dance", "", "wave; rm", "w" * 257, "x" * 1_000_000])
def test_unknown_or_oversized_text_is_ignored_and_counted(standing: Supervisor, text: str) -> None:
    reply = standing.text(text)
    assert not reply.accepted
    assert len(reply.reason) < 300
    assert standing.ignored == 1
    assert standing.mode is Mode.STAND
    assert standing.take_motion() is None


def test_longest_text_that_is_read(standing: Supervisor) -> None:
    assert standing.text("wave".ljust(256)).accepted


@pytest.mark.parametrize(
    ("health", "culprit"),
    [
        (replace(WELL, tilt=0.8), "tilt 0.80 rad"),
        (replace(WELL, tilt=float("nan")), "tilt nan"),
        (replace(WELL, state_stamp=0.85), "state estimate older"),
        (replace(WELL, command_stamp=0.85), "whole-body command older"),
        (replace(WELL, drivers_damped=True), "drivers fell back"),
        (replace(WELL, status=SolveStatus.DAMPED), "no usable torques"),
        (replace(WELL, overruns=20), "overran its time budget in 20 ticks in a row"),
    ],
)
def test_fault_damps_latches_and_names_the_cause(standing: Supervisor, health: Health, culprit: str) -> None:
    assert standing.update(health, 1.0) is Mode.DAMP
    assert culprit in standing.faults[0]
    assert standing.update(WELL, 1.0) is Mode.DAMP
    refused = standing.request(Mode.STAND)
    assert not refused.accepted
    assert culprit in refused.reason
    assert standing.reset_faults().accepted
    assert standing.mode is Mode.DAMP
    assert "have not been repeated" in standing.request(Mode.STAND).reason
    standing.set_preflight(())
    assert standing.request(Mode.STAND).accepted


def test_healthy_robot_keeps_standing(standing: Supervisor) -> None:
    barely = replace(WELL, tilt=0.69, state_stamp=0.95, command_stamp=0.95, overruns=19)
    assert standing.update(barely, 1.0) is Mode.STAND
    assert standing.faults == ()


def test_stop_ends_a_trajectory_that_was_not_requested_from_the_supervisor(standing: Supervisor) -> None:
    assert standing.text("stop").accepted
    assert (standing.mode, standing.take_motion()) == (Mode.STAND, "stop")


def test_estop_damps_from_any_mode_and_outlives_a_new_start_where_told(law: Supervisor) -> None:
    law.estop()
    assert law.mode is Mode.DAMP and law.stopped  # off: the start of a real robot may hold it stiff
    law.reset(stopped=law.stopped)
    law.set_preflight(())
    assert not law.request(Mode.STAND).accepted
    law.reset()
    law.set_preflight(())
    assert not law.stopped
    law.request(Mode.STAND)
    law.text("wave")
    law.estop()
    assert law.mode is Mode.DAMP
    assert law.faults == ("emergency stop",)
    assert law.take_motion() is None


@pytest.fixture
def walker(g1: RobotModel) -> Supervisor:
    supervisor = Supervisor(g1, gait=True)
    supervisor.set_preflight(())
    assert supervisor.request(Mode.STAND).accepted
    return supervisor


def test_walk_and_its_words(walker: Supervisor) -> None:
    assert walker.text("walk").accepted
    assert walker.mode is Mode.WALK
    assert walker.take_velocity() is None
    assert walker.text("backward").accepted
    assert walker.take_velocity() == (-walker.config.text_speed, 0.0, 0.0)
    assert walker.take_velocity() is None
    assert walker.text("spin").accepted
    assert walker.take_velocity() == (0.0, 0.0, walker.config.text_spin)
    assert "'squat' refused in mode 'walk', only: wave; request 'stand' first" in walker.text("squat").reason


def test_arms_wave_while_the_legs_go_on(walker: Supervisor) -> None:
    walker.text("forward")
    walker.take_velocity()
    assert walker.text("wave").accepted
    assert (walker.mode, walker.take_motion(), walker.motion) == (Mode.WALK, "wave", "wave")
    assert "busy with 'wave'" in walker.text("wave").reason
    assert "only: wave" in walker.text("squat").reason  # that it waves is not what stands in the way
    moving = replace(WELL, gait_active=True)
    assert walker.update(replace(moving, motion_active=True), 1.0) is Mode.WALK
    assert walker.text("left").accepted and walker.motion == "wave"  # a word for the legs leaves the arms alone
    assert walker.update(moving, 1.01) is Mode.WALK
    assert walker.motion is None
    assert walker.text("wave").accepted
    assert walker.motion_refused("no way").reason == "motion 'wave' refused: no way"
    assert (walker.mode, walker.motion) == (Mode.WALK, None)


def test_a_wave_that_never_begins_is_given_up_and_stop_ends_it_with_the_walk(walker: Supervisor) -> None:
    walker.text("forward")
    walker.text("wave")
    moving = replace(WELL, gait_active=True)
    late = walker.config.plan_timeout + 1.0
    walker.update(moving, 0.0)
    walker.update(replace(moving, state_stamp=late, command_stamp=late), late)
    assert (walker.mode, walker.motion) == (Mode.WALK, None)
    walker.text("wave")
    walker.take_motion()
    assert walker.text("stop").accepted
    assert (walker.mode, walker.take_motion(), walker.motion) == (Mode.WALK, "stop", None)
    assert "comes to a standstill" in walker.text("wave").reason


def test_stop_ends_the_walk_once_the_robot_stands_still(walker: Supervisor) -> None:
    walker.text("forward")
    walker.take_velocity()
    assert walker.text("stop").accepted
    assert walker.take_velocity() == (0.0, 0.0, 0.0)
    assert walker.update(replace(WELL, gait_active=True), 1.0) is Mode.WALK
    assert walker.update(WELL, 1.01) is Mode.STAND


def test_a_new_word_before_the_standstill_goes_on_walking(walker: Supervisor) -> None:
    walker.text("forward")
    walker.request(Mode.STAND)
    assert walker.text("left").accepted
    assert walker.update(WELL, 1.0) is Mode.WALK
    assert walker.take_velocity() == (0.0, walker.config.text_side_speed, 0.0)


def test_walking_is_refused_from_damp_and_a_fault_ends_it(walker: Supervisor) -> None:
    walker.text("forward")
    walker.fault("tipped over")
    assert walker.mode is Mode.DAMP
    assert walker.take_velocity() is None
    assert not walker.text("walk").accepted


def test_a_drop_out_longer_than_the_limit_damps_and_names_the_imu(standing: Supervisor) -> None:
    assert standing.update(replace(WELL, coasting=0.049), 1.0) is Mode.STAND
    assert standing.update(replace(WELL, coasting=0.051), 1.0) is Mode.DAMP
    assert standing.faults == ("no usable samples of the IMU (or the joints) for 0.051 s, more than 0.050 s",)


INTRUDER = replace(WELL, intruders=(second_publisher("/joint_states", "node '/student'"),))
SILENT = replace(WELL, silent=("motion_planner",))


def test_a_second_publisher_ends_a_walk_with_its_step_and_latches(walker: Supervisor) -> None:
    assert walker.text("forward").accepted
    walker.take_velocity()
    assert walker.update(replace(INTRUDER, gait_active=True), 1.0) is Mode.WALK
    assert walker.take_velocity() == (0.0, 0.0, 0.0)
    assert walker.still
    assert walker.update(replace(WELL, gait_active=True), 1.05) is Mode.WALK
    assert "'/joint_states' has a second publisher" in walker.text("walk").reason
    assert walker.update(WELL, 1.08) is Mode.STAND
    for refused in (walker.text("walk"), walker.text("wave"), walker.request(Mode.WALK)):
        assert not refused.accepted
        assert "'/joint_states' has a second publisher" in refused.reason
    assert walker.reset_faults().accepted
    assert walker.text("walk").accepted


def test_a_second_publisher_ends_a_motion_where_it_is(standing: Supervisor) -> None:
    assert standing.text("wave").accepted
    standing.take_motion()
    assert standing.update(replace(INTRUDER, motion_active=True), 1.0) is Mode.STAND
    assert standing.take_motion() == "stop"
    assert standing.update(INTRUDER, 1.05) is Mode.STAND
    assert standing.take_motion() is None


def test_a_hold_ends_with_its_cause(walker: Supervisor) -> None:
    assert walker.text("walk").accepted
    walker.update(replace(SILENT, gait_active=True), 1.0)
    assert walker.mode is Mode.WALK and walker.still and walker.take_velocity() == (0.0, 0.0, 0.0)
    assert "node 'motion_planner' sends no diagnostics" in walker.text("wave").reason
    assert not walker.text("forward").accepted and walker.drive(True, fresh=False).accepted
    assert walker.update(SILENT, 1.02) is Mode.STAND
    walker.update(WELL, 1.05)
    assert "send a zero velocity, or pause, before a new velocity" in walker.drive(True, fresh=False).reason
    assert not walker.still
    assert walker.text("wave").accepted
    assert not walker.faults


def test_the_most_severe_fault_wins(walker: Supervisor) -> None:
    assert walker.text("walk").accepted
    assert walker.update(replace(INTRUDER, tilt=1.0, silent=("motion_planner",)), 1.0) is Mode.DAMP
    assert len(walker.faults) == 2


def test_a_damped_robot_has_no_holds_left(walker: Supervisor) -> None:
    assert walker.update(replace(SILENT, tilt=1.0), 1.0) is Mode.DAMP
    assert walker.holds == () and not walker.still


@pytest.mark.parametrize(
    ("sentence", "word"),
    [
        ("please go forward", "forward"),
        ("Robot, walk forward!", "forward"),
        ("Can you turn around, please?", "turn"),
        ("walk", "walk"),
    ],
)
def test_a_sentence_holds_a_command(walker: Supervisor, sentence: str, word: str) -> None:
    assert walker.text(sentence).accepted
    velocity = walker.take_velocity()
    walker.request(Mode.STAND)
    walker.update(WELL, 1.0)
    assert walker.text(word).accepted
    assert walker.take_velocity() == velocity


@pytest.mark.parametrize(
    "sentence", ["turn left", "raise your left hand", "don't wave", "do not walk", "please", "wave, squat"]
)
def test_a_sentence_that_may_mean_something_else_is_ignored(walker: Supervisor, sentence: str) -> None:
    assert not walker.text(sentence).accepted
    assert (walker.ignored, walker.mode, walker.motion) == (1, Mode.STAND, None)


def test_stop_is_executed_in_any_sentence(walker: Supervisor) -> None:
    assert walker.text("forward").accepted
    walker.take_velocity()
    assert walker.text("stop now; do not wave").accepted
    assert walker.take_velocity() == (0.0, 0.0, 0.0)


def test_a_velocity_begins_a_walk_that_ends_in_a_stand(walker: Supervisor) -> None:
    assert walker.drive(False, fresh=True).accepted and walker.mode is Mode.STAND
    assert walker.drive(True, fresh=True).accepted and walker.mode is Mode.WALK
    walker.rest()
    assert walker.take_velocity() == (0.0, 0.0, 0.0)
    assert walker.update(replace(WELL, gait_active=True), 1.0) is Mode.WALK
    assert walker.drive(True, fresh=False).accepted  # before the standstill it goes on
    assert walker.update(WELL, 1.02) is Mode.WALK
    walker.rest()
    assert walker.update(WELL, 1.04) is Mode.STAND


def test_a_walk_that_was_requested_goes_on_at_zero_velocity(walker: Supervisor) -> None:
    assert walker.drive(True, fresh=True).accepted
    assert walker.request(Mode.WALK).accepted
    walker.rest()
    assert walker.update(WELL, 1.0) is Mode.WALK and walker.take_velocity() is None


@pytest.mark.parametrize("way", ["stop", "fault", "damp"])
def test_a_velocity_that_goes_on_after_a_stop_begins_no_walk(walker: Supervisor, way: str) -> None:
    assert walker.drive(True, fresh=True).accepted
    if way == "stop":
        walker.text("stop")
        assert walker.drive(True, fresh=False).accepted and walker.still
        walker.update(WELL, 1.0)
    else:
        walker.fault("tipped over") if way == "fault" else walker.request(Mode.DAMP)
        why = "tipped over" if way == "fault" else "preflight"
        assert f"request 'stand' first, which is refused: {'latched faults: ' * (way == 'fault')}{why}" in (
            walker.drive(True, fresh=False).reason
        )
        walker.reset_faults()
        walker.set_preflight(())
        assert walker.request(Mode.STAND).accepted
    reply = walker.drive(True, fresh=False)
    assert not reply.accepted and "send a zero velocity, or pause, before a new velocity" in reply.reason
    assert walker.mode is Mode.STAND
    assert walker.drive(True, fresh=True).accepted and walker.mode is Mode.WALK


def test_only_its_own_zero_or_pause_lets_a_velocity_walk_again(walker: Supervisor) -> None:
    assert walker.drive(True, fresh=True, source="plain").accepted
    walker.text("stop")
    assert walker.drive(False, fresh=True, source="autonomy").accepted
    assert walker.barred("plain", fresh=False) and walker.drive(True, fresh=False, source="plain").accepted
    assert walker.still and walker.update(WELL, 1.0) is Mode.STAND
    assert not walker.drive(True, fresh=False, source="plain").accepted
    assert walker.drive(True, fresh=False, source="autonomy").accepted and walker.mode is Mode.WALK
    assert (
        "send a zero velocity, or pause, before a new velocity"
        in walker.drive(True, fresh=False, source="plain").reason
    )
    walker.rest()
    assert walker.update(WELL, 1.02) is Mode.STAND and walker.barred("plain", fresh=False)
    assert walker.drive(True, fresh=True, source="plain").accepted


def test_no_walk_begins_before_the_robot_stands_by_itself(walker: Supervisor) -> None:
    walker.request(Mode.DAMP)
    walker.set_preflight(())
    walker.request(Mode.STAND)
    assert walker.barred("plain", fresh=False)  # a velocity from before it stood up
    walker.held = True
    for reply in (walker.text("forward"), walker.request(Mode.WALK), walker.drive(True, fresh=True)):
        assert not reply.accepted and "held at its start" in reply.reason
    assert walker.mode is Mode.STAND and walker.take_velocity() is None
    walker.held = False
    assert walker.drive(True, fresh=True).accepted and walker.mode is Mode.WALK


def test_velocities_begin_no_walk_where_that_is_disabled(g1: RobotModel) -> None:
    config = replace(default_config(SupervisorConfig, "controllers", "supervisor"), walk_on_velocity=False)
    law = Supervisor(g1, config, gait=True)
    law.set_preflight(())
    law.request(Mode.STAND)
    assert "request mode/walk first" in law.drive(True, fresh=True).reason
    law.request(Mode.WALK)
    assert law.drive(True, fresh=True).accepted


def test_a_second_publisher_that_has_gone_is_forgotten_once_the_robot_stands(walker: Supervisor) -> None:
    assert walker.text("forward").accepted
    walker.update(replace(INTRUDER, gait_active=True), 1.0)
    assert walker.update(replace(WELL, gait_active=True), 1.02) is Mode.WALK
    assert walker.faults == INTRUDER.intruders  # it still walks
    walker.update(WELL, 1.04)
    walker.fault("another cause", Severity.DAMP)
    assert walker.mode is Mode.DAMP and walker.faults[-1] == "another cause"
    walker.reset_faults()
    walker.set_preflight(())
    walker.request(Mode.STAND)
    walker.update(INTRUDER, 1.06)
    assert walker.faults == INTRUDER.intruders
    walker.update(WELL, 1.08)
    assert walker.faults == () and walker.text("walk").accepted


def test_a_walk_without_a_gait_planner_ends_in_a_stand(walker: Supervisor) -> None:
    assert walker.request(Mode.WALK).accepted
    walker.gait = False
    assert walker.update(replace(WELL, gait_active=True), 1.0) is Mode.WALK
    assert walker.still
    assert walker.update(WELL, 1.0) is Mode.STAND
    assert "no gait planner runs" in walker.request(Mode.WALK).reason
    walker.gait = True
    assert not walker.drive(True, fresh=False).accepted  # the velocity goes on from before
    assert walker.drive(True, fresh=True).accepted
