"""What each kind of fault makes of a sensor and of a motor, when, and that nothing else is touched."""

import math
from collections.abc import Iterable

import numpy as np
import pytest

from bridge.plants.fault_plan import Fault, FaultPlan, Faults
from bridge.plants.fault_proxy import FaultProxy
from bridge.plants.mujoco import MujocoPlant
from bridge.plants.sensors import TAIL, unpack
from models.robot_model import RobotModel
from models.scan import Scan
from models.types import JointCommand, SensorData

KNEE = "left_knee_joint"
NAN = math.nan


def proxy(g1: RobotModel, faults: Faults, seed: int = 0) -> FaultProxy:
    made = FaultProxy(g1, period=0.001, seed=seed)
    made.inject(faults)
    return made


def ramp(g1: RobotModel, tick: int) -> np.ndarray:
    """Every channel counts the ticks, starting at 10."""
    return np.full(3 * g1.nj + TAIL, 10.0 + tick)


def sensed(g1: RobotModel, made: FaultProxy, ticks: Iterable[int]) -> list[SensorData]:
    """Samples of a ramp behind the proxy."""
    samples, before = [], None
    for tick in ticks:
        values = ramp(g1, tick)
        made.sense(tick, values, ramp(g1, tick - 1) if before is None else before)
        before = values
        samples.append(unpack(0.001 * tick, values, g1.nj))
    return samples


def driven(g1: RobotModel, made: FaultProxy, ticks: int) -> np.ndarray:
    """Torques of the left knee [N.m], asked for 10, 11, 12, ..., 9 having been given before (ticks,)."""
    knee, before, given = g1.joint_index(KNEE), np.full(g1.nj, 9.0), []
    for tick in range(ticks):
        tau = np.full(g1.nj, 10.0 + tick)
        before = made.drive(tick, tau, before)
        others = np.delete(before, knee)
        np.testing.assert_array_equal(others, 10.0 + tick)
        given.append(before[knee])
    return np.array(given)


SENSOR_CASES = [
    (Fault("imu", "off"), [9, 9, 9, 9, 9, NAN, NAN, NAN]),
    (Fault("imu", "stuck"), [9] * 8),
    (Fault("imu", "stuck", value=3.0), [3] * 8),
    (Fault("imu", "wrong", value=NAN), [NAN] * 8),
    (Fault("imu", "wrong", scale=2.0, offset=1.0, drift=1000.0), [21, 24, 27, 30, 33, 36, 39, 42]),
    (Fault("imu", "slow", rate=250.0), [10, 10, 10, 10, 14, 14, 14, 14]),
    (Fault("imu", "delayed", delay=0.003), [9, 9, 9, 10, 11, 12, 13, 14]),
    (Fault("imu", "intermittent", period=0.004, share=0.5), [9, 9, 12, 13, 13, 13, 16, 17]),
    (Fault("imu", "off", start=0.002, end=0.004), [10, 11, 11, 11, 14, 15, 16, 17]),
]


@pytest.mark.parametrize(("fault", "expected"), SENSOR_CASES, ids=[str(case[0]) for case in SENSOR_CASES])
def test_each_kind_on_the_inertial_unit(g1: RobotModel, fault: Fault, expected: list[float]) -> None:
    samples = sensed(g1, proxy(g1, fault), range(8))
    for axis in range(3):
        np.testing.assert_allclose([s.gyro[axis] for s in samples], expected)
        np.testing.assert_allclose([s.accel[axis] for s in samples], expected)
    for name in ("q", "v", "tau", "wrenches"):
        for tick, sample in enumerate(samples):
            np.testing.assert_array_equal(getattr(sample, name), 10.0 + tick)


MOTOR_CASES = [
    (Fault(f"motor:{KNEE}", "off"), [0] * 6),
    (Fault(f"motor:{KNEE}", "stuck"), [9] * 6),
    (Fault(f"motor:{KNEE}", "stuck", value=-5.0), [-5] * 6),
    (Fault(f"motor:{KNEE}", "wrong", scale=0.5), [5, 5.5, 6, 6.5, 7, 7.5]),
    (Fault(f"motor:{KNEE}", "wrong", offset=-1.0), [9, 10, 11, 12, 13, 14]),
    (Fault(f"motor:{KNEE}", "slow", rate=500.0), [10, 10, 12, 12, 14, 14]),
    (Fault(f"motor:{KNEE}", "delayed", delay=0.002), [9, 9, 10, 11, 12, 13]),
    (Fault(f"motor:{KNEE}", "intermittent", period=0.003, share=0.34), [0, 11, 12, 0, 14, 15]),
    (Fault(f"motor:{KNEE}", "off", start=0.002, end=0.004), [10, 11, 0, 0, 14, 15]),
]


@pytest.mark.parametrize(("fault", "expected"), MOTOR_CASES, ids=[str(case[0]) for case in MOTOR_CASES])
def test_each_kind_on_a_motor(g1: RobotModel, fault: Fault, expected: list[float]) -> None:
    np.testing.assert_allclose(driven(g1, proxy(g1, fault), 6), expected)


def test_no_motor_gives_more_than_it_can(g1: RobotModel) -> None:
    limit = g1.tau_max[g1.joint_index(KNEE)]
    np.testing.assert_array_equal(driven(g1, proxy(g1, Fault(f"motor:{KNEE}", "wrong", scale=1e6)), 3), limit)
    np.testing.assert_array_equal(driven(g1, proxy(g1, Fault(f"motor:{KNEE}", "saturated")), 3), limit)
    garbage = driven(g1, proxy(g1, Fault(f"motor:{KNEE}", "garbage")), 400)
    assert np.abs(garbage).max() <= limit
    assert garbage.min() < -0.9 * limit and garbage.max() > 0.9 * limit and abs(garbage.mean()) < 0.1 * limit
    small = driven(g1, proxy(g1, Fault(f"motor:{KNEE}", "garbage", scale=0.1)), 400)
    assert 0.08 * limit < np.abs(small).max() <= 0.1 * limit


def test_motors_that_saturate_early_keep_smaller_torques(g1: RobotModel) -> None:
    made = proxy(g1, Fault("motors", "saturated", scale=0.6))
    desired = np.linspace(-1.0, 1.0, g1.nj) * g1.tau_max
    expected = np.clip(desired, -0.6 * g1.tau_max, 0.6 * g1.tau_max)
    np.testing.assert_allclose(made.drive(0, desired, np.zeros(g1.nj)), expected)


def test_garbage_and_saturation_of_sensors_span_their_full_scale(g1: RobotModel) -> None:
    imu = g1.profile.sensors.imu
    gyro = np.array([s.gyro for s in sensed(g1, proxy(g1, Fault("imu", "garbage")), range(400))])
    assert 0.95 * imu.gyro_range < np.abs(gyro).max() <= imu.gyro_range
    assert np.ptp(gyro, axis=1).min() > 0.0  # each axis for itself
    sample = sensed(g1, proxy(g1, Fault("imu.accel", "saturated")), range(1))[0]
    np.testing.assert_array_equal(sample.accel, imu.accel_range)
    np.testing.assert_array_equal(sample.gyro, 10.0)
    sample = sensed(g1, proxy(g1, Fault("foot:right", "saturated", scale=0.001)), range(1))[0]
    feet = g1.profile.sensors.feet
    np.testing.assert_allclose(sample.wrenches[1], np.repeat([0.001 * feet.force_range, 0.001 * feet.torque_range], 3))
    np.testing.assert_array_equal(sample.wrenches[0], 10.0)
    joints = sensed(g1, proxy(g1, Fault("joints", "garbage")), range(50))
    assert all((s.q >= g1.q_lower).all() and (s.q <= g1.q_upper).all() for s in joints)


@pytest.mark.parametrize(
    ("target", "changed"),
    [
        ("imu.gyro", {"gyro"}),
        ("imu.accel", {"accel"}),
        ("imu", {"gyro", "accel"}),
        ("joints", {"q", "v"}),
        ("torques", {"tau"}),
        ("feet", {"wrenches"}),
    ],
)
def test_a_target_is_what_it_says(g1: RobotModel, target: str, changed: set[str]) -> None:
    sample = sensed(g1, proxy(g1, Fault(target, "wrong", value=NAN)), range(1))[0]
    for name in ("q", "v", "tau", "gyro", "accel", "wrenches"):
        value = getattr(sample, name)
        assert np.isnan(value).all() if name in changed else (value == 10.0).all()


def test_an_encoder_that_is_stuck_or_shifted(g1: RobotModel) -> None:
    knee = g1.joint_index(KNEE)
    cases = (
        (Fault(f"joint:{KNEE}", "stuck"), 9.0, 0.0),  # at the last position, no velocity
        (Fault(f"joint:{KNEE}", "wrong", value=0.3), 0.3, 0.0),
        (Fault(f"joint:{KNEE}", "wrong", offset=0.05), 12.05, 12.0),  # a shifted zero has no velocity
        (Fault(f"joint:{KNEE}", "off"), NAN, NAN),
    )
    for fault, q, v in cases:
        sample = sensed(g1, proxy(g1, fault), range(3))[2]
        np.testing.assert_allclose((sample.q[knee], sample.v[knee], sample.tau[knee]), (q, v, 12.0))
        np.testing.assert_array_equal(np.delete(sample.q, knee), 12.0)
        np.testing.assert_array_equal(np.delete(sample.v, knee), 12.0)


def received(g1: RobotModel, made: FaultProxy, ticks: int) -> list[SensorData | None]:
    return [made.transmit(tick, unpack(0.001 * tick, ramp(g1, tick), g1.nj)) for tick in range(ticks)]


def test_joint_states_are_lost_on_their_way_only(g1: RobotModel) -> None:
    made = proxy(g1, Fault("joint_states", "off", end=0.002))
    assert [sample is None for sample in received(g1, made, 4)] == [True, True, False, False]
    made = proxy(g1, Fault("joint_states", "slow", rate=500.0))
    assert [sample is None for sample in received(g1, made, 4)] == [False, True, False, True]
    made = proxy(g1, Fault("joint_states", "delayed", delay=0.002))
    late = [sample for sample in received(g1, made, 4) if sample is not None]
    assert [(s.t, s.q[0], s.tau[0], s.gyro[0]) for s in late] == [
        (0.0, 10.0, 10.0, 10.0), (0.001, 10.0, 10.0, 11.0), (0.002, 10.0, 10.0, 12.0), (0.003, 11.0, 11.0, 13.0)
    ]  # fmt: skip
    np.testing.assert_array_equal(ramp(g1, 0), sensed_values(g1, made))  # the drivers have theirs


def test_stamps_are_repeated_old_or_ahead(g1: RobotModel) -> None:
    """As the laws get them; everything else is as it was."""
    cases = (
        (Fault("stamps", "stuck"), [0.0, 0.0, 0.0]),
        (Fault("stamps", "wrong", offset=-0.05), [-0.05, -0.049, -0.048]),
        (Fault("stamps", "delayed", delay=0.001), [0.0, 0.0, 0.001]),
    )
    for fault, expected in cases:
        made = proxy(g1, fault)
        samples = [sample for sample in received(g1, made, 3) if sample is not None]
        np.testing.assert_allclose([sample.t for sample in samples], expected, atol=1e-12)
        assert [sample.q[0] for sample in samples] == [10.0, 11.0, 12.0]
        assert made.corrupted and not made.missing


def test_scans_are_lost_late_slower_or_wrong(g1: RobotModel) -> None:
    """Every 100 ticks, of readings that count the scans; a scan is a message of its own."""

    rays = g1.profile.sensors.scan.rays

    def seen(fault: Fault) -> list[float]:
        made, reported = proxy(g1, fault), list[float]()
        for number in range(4):
            scan = made.transmit_scan(
                100 * number, Scan(0.1 * number, -1.0, 0.1, np.full(rays, 1.0 + number), 0.05, 10.0)
            )
            reported.append(0.0 if scan is None else float(scan.ranges[-1]))
        assert not made.missing and not made.corrupted
        return reported

    assert seen(Fault("scan", "off", end=0.15)) == [0.0, 0.0, 3.0, 4.0]
    assert seen(Fault("scan", "slow", rate=5.0)) == [1.0, 0.0, 3.0, 0.0]
    assert seen(Fault("scan", "stuck")) == [1.0] * 4
    assert seen(Fault("scan", "delayed", delay=0.1)) == [1.0, 1.0, 2.0, 3.0]
    assert seen(Fault("scan", "wrong", scale=2.0)) == [2.0, 4.0, 6.0, 8.0]
    assert seen(Fault("scan", "stuck", value=math.inf)) == [math.inf] * 4
    assert seen(Fault("imu", "off")) == [1.0, 2.0, 3.0, 4.0]


def sensed_values(g1: RobotModel, made: FaultProxy) -> np.ndarray:
    values = ramp(g1, 0)
    made.sense(0, values, None)
    return values


def test_asking_twice_in_a_tick_gives_the_same(g1: RobotModel) -> None:
    made = proxy(g1, Fault("joint_states", "garbage"))
    sample = unpack(0.0, ramp(g1, 0), g1.nj)
    assert made.transmit(0, sample) is made.transmit(0, sample) is not sample


def test_messages_that_do_not_come_are_named(g1: RobotModel) -> None:
    made = proxy(g1, [Fault("imu.gyro", "off", end=0.002), Fault("feet", "intermittent", period=0.002)])
    seen = []
    for tick in range(4):
        made.sense(tick, ramp(g1, tick), ramp(g1, tick - 1))
        seen.append(set(made.missing))
    feet = {"foot:left", "foot:right"}
    assert seen == [{"imu", *feet}, {"imu"}, feet, set()]


def test_random_faults_depend_on_seed_and_order_only(g1: RobotModel) -> None:
    faults = [Fault("imu", "garbage"), Fault("feet", "intermittent", probability=0.5)]

    def drawn(seed: int, plan: list[Fault]) -> np.ndarray:
        samples = sensed(g1, proxy(g1, plan, seed), range(40))
        return np.array([[*s.gyro, *s.wrenches.ravel()] for s in samples])

    np.testing.assert_array_equal(drawn(5, faults), drawn(5, faults))
    assert not np.array_equal(drawn(5, faults)[:, :3], drawn(6, faults)[:, :3])
    np.testing.assert_array_equal(drawn(5, faults)[:, :3], drawn(5, [faults[0], Fault("torques", "garbage")])[:, :3])
    made = proxy(g1, faults, 5)
    first = np.array([s.gyro for s in sensed(g1, made, range(40))])
    made.reset(5)
    made.inject(faults)
    np.testing.assert_array_equal(np.array([s.gyro for s in sensed(g1, made, range(40))]), first)


def test_two_random_faults_draw_apart(g1: RobotModel) -> None:
    imu = g1.profile.sensors.imu
    sample = sensed(g1, proxy(g1, [Fault("imu.gyro", "garbage"), Fault("imu.accel", "garbage")]), range(1))[0]
    assert np.abs(sample.gyro / imu.gyro_range - sample.accel / imu.accel_range).min() > 0.01


def test_faults_of_one_target_act_one_after_the_other(g1: RobotModel) -> None:
    made = proxy(g1, [Fault("imu", "wrong", offset=1.0), Fault("imu", "wrong", scale=2.0)])
    np.testing.assert_array_equal(sensed(g1, made, range(1))[0].gyro, 22.0)


def test_begin_and_end_are_reported_and_the_end_leaves_nothing(g1: RobotModel) -> None:
    made, reported = FaultProxy(g1, period=0.001, seed=0), list[str]()
    made.note = reported.append
    fault = Fault("imu", "stuck", start=0.002, end=0.004)
    assert made.inject(fault) == f"injected: {fault}"
    sensed(g1, made, range(6))
    assert reported == [f"injected: {fault}", f"fault begins: {fault}", f"fault ends: {fault}"]
    assert not made.active and made.injected == () and made.missing == frozenset()
    made.inject(fault)
    assert made.clear() == f"cleared: {fault}" and not made.active
    assert made.clear() == "cleared: no faults" and len(reported) == 5


def test_without_faults_nothing_is_looked_at(g1: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same arrays and samples pass, and a fault that is over leaves no trace in what follows."""

    def touched(*args: object) -> None:
        raise AssertionError("looked at")

    plain, other = MujocoPlant(g1, seed=2), MujocoPlant(g1, seed=2)
    other.faults.inject(Fault("imu", "garbage", end=0.003))
    for tick in range(6):
        if tick == 4:
            monkeypatch.setattr(FaultProxy, "sense", touched)
            monkeypatch.setattr(FaultProxy, "drive", touched)
        samples = plain.read(), other.read()
        assert np.array_equal(samples[0].gyro, samples[1].gyro) == (tick >= 3)
        np.testing.assert_array_equal(samples[0].q, samples[1].q)
        assert plain.transmit(samples[0]) is samples[0]
        for plant in (plain, other):
            plant.write(JointCommand.torque(np.zeros(g1.nj)))
            plant.step()


def test_a_plan_begins_at_the_start_or_at_the_release(g1: RobotModel) -> None:
    fault = Fault("imu", "wrong", value=NAN)
    for since in ("start", "release"):
        plant = MujocoPlant(g1, faults=FaultPlan((fault,), since))
        for _ in range(2):
            assert plant.faults.active == (since == "start")
            assert np.isnan(plant.read().gyro).all() == (since == "start")
            plant.step()
            for _ in range(2):
                plant.release()
                assert plant.faults.injected == (fault,)
            plant.reset()
