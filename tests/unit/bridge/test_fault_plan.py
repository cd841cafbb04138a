"""Faults as Python and YAML say them, and what is refused by name."""

import math
from pathlib import Path

import pytest

from bridge.plants.fault_plan import Fault, FaultPlan, fault_plan, scenario_names
from bridge.plants.fault_proxy import FaultProxy
from models.errors import ConfigError
from models.robot_model import RobotModel


def test_every_way_of_saying_it_gives_the_same_plan(tmp_path: Path) -> None:
    faults = (Fault("imu", "off", end=0.02), Fault("imu.gyro", "wrong", start=1.0, offset=(0.05, 0.0, 0.0)))
    listed = "[{target: imu, kind: off, end: 0.02}, {target: imu.gyro, kind: wrong, start: 1, offset: [0.05, 0, 0]}]"
    block = "- {target: imu, kind: off, end: 0.02}\n- {target: imu.gyro, kind: wrong, start: 1, offset: [0.05, 0, 0]}"
    file = tmp_path / "both.yaml"
    file.write_text(f"since: release\nfaults: {listed}\n")
    for given in (FaultPlan(faults), faults, list(faults), listed, block, f"{{faults: {listed}}}", file, str(file)):
        assert fault_plan(given) == FaultPlan(faults)
    assert fault_plan("{target: imu, kind: off, end: 0.02}") == fault_plan(faults[0]) == FaultPlan(faults[:1])
    assert fault_plan(None) == FaultPlan(())


def test_words_tell_target_kind_parameters_and_times() -> None:
    fault = Fault("motor:left_knee_joint", "wrong", scale=0.5, start=1.0, end=2.0)
    assert str(fault) == "motor:left_knee_joint wrong (scale 0.5, from 1 s, until 2 s)"
    assert str(Fault("imu", "off")) == "imu off"
    assert str(FaultPlan(())) == "no faults"


@pytest.mark.parametrize("name", scenario_names())
def test_packaged_scenarios_fit_the_g1(g1: RobotModel, name: str) -> None:
    assert FaultProxy(g1, period=0.001, seed=0).inject(name).startswith("injected: ")


@pytest.mark.parametrize(
    ("text", "culprit"),
    [
        ("{target: imu, kind: off, tend: 1}", "unknown key 'tend'; known: target, kind, start, end, value"),
        ("{target: nose, kind: off}", "unknown target 'nose'; known: imu, imu.gyro"),
        ("{target: 'joint:', kind: off}", "unknown target 'joint:'"),
        ("{target: 'foot:middle', kind: off}", "unknown target 'foot:middle'"),
        ("{target: imu, kind: mad}", "unknown kind 'mad'; known: off, stuck, garbage"),
        ("{kind: off}", "target: missing"),
        ("[{target: imu, kind: off}, {target: imu}]", r"faults\[1\]: kind: missing"),
        ("[7]", "expected a mapping of keys, found int"),
        ("{faults: 7}", "expected a list of faults"),
        ("{since: dawn, faults: []}", "since: unknown 'dawn'; known: start, release"),
        ("{until: 1, faults: []}", "unknown key 'until'; known: since, faults"),
        ("{target: imu, kind: off, value: 1}", "value: not a parameter of this kind; known: start, end$"),
        ("{target: imu, kind: off, start: soon}", "start: 'soon' is not a number"),
        ("{target: imu, kind: off, start: true}", "start: True is not a number"),
        ("{target: imu, kind: off, start: -1}", "before the injection"),
        ("{target: imu, kind: off, start: .nan}", "start: nan is not finite"),
        ("{target: imu, kind: off, start: 1, end: 1}", "not after the start"),
        ("{target: imu, kind: slow}", "rate: missing"),
        ("{target: imu, kind: slow, rate: 0}", "rate: 0 is not positive"),
        ("{target: imu, kind: delayed}", "delay: missing"),
        ("{target: imu, kind: delayed, delay: [1, 2]}", "delay: .* is not a number"),
        ("{target: imu, kind: wrong}", "give either value, or some of offset, scale and drift"),
        ("{target: imu, kind: wrong, value: 1, scale: 2}", "give either value"),
        ("{target: imu, kind: wrong, scale: .inf}", "scale: inf is not finite"),
        ("{target: imu, kind: wrong, offset: many}", "offset: 'many' is not a number"),
        ("{target: motors, kind: wrong, value: .nan}", "value: nan is not finite"),
        ("{target: stamps, kind: off}", "is not possible; known: stuck, wrong, delayed"),
        ("{target: stamps, kind: wrong, value: .inf}", "value: inf is not finite"),
        ("{target: imu, kind: garbage, scale: -1}", "negative"),
        ("{target: imu, kind: intermittent}", "probability: give either probability or period"),
        ("{target: imu, kind: intermittent, probability: 0.1, period: 1}", "give either probability or period"),
        ("{target: imu, kind: intermittent, probability: 2}", r"not in \(0, 1\]"),
        ("{target: imu, kind: intermittent, probability: 0.1, share: 0.1}", "share: needs period"),
        ("{target: imu, kind: off", "not valid YAML"),
        ("no_such_scenario", "unknown scenario 'no_such_scenario'; known: .*dead_knee"),
        ("/nowhere/faults.yaml", "cannot be read"),
    ],
)
def test_what_is_wrong_is_named(text: str, culprit: str) -> None:
    with pytest.raises(ConfigError, match=culprit):
        fault_plan(text)


@pytest.mark.parametrize(
    ("fault", "culprit"),
    [
        (Fault("joint:tail_joint", "off"), "g1: unknown joint 'tail_joint'; known: left_hip_pitch_joint"),
        (Fault("motor:tail_joint", "off"), "unknown joint 'tail_joint'"),
        (Fault("torque:tail_joint", "off"), "unknown joint 'tail_joint'"),
        (Fault("imu.gyro", "wrong", offset=(1.0, 2.0)), "offset: 2 numbers, expected 1 or 3"),
        (Fault("imu", "slow", rate=1001.0), "rate: 1001.0 Hz is above that of the ticks, 1000 Hz"),
    ],
)
def test_what_does_not_fit_the_robot_is_refused_and_nothing_injected(
    g1: RobotModel, fault: Fault, culprit: str
) -> None:
    proxy = FaultProxy(g1, period=0.001, seed=0)
    with pytest.raises(ConfigError, match=culprit):
        proxy.inject([Fault("imu", "off"), fault])
    assert proxy.injected == () and not proxy.active
    with pytest.raises(ConfigError, match=culprit):
        FaultProxy(g1, period=0.001, seed=0, plan=fault)


def test_nan_and_infinity_are_values_of_sensors() -> None:
    assert math.isnan(fault_plan("{target: joints, kind: wrong, value: .nan}").faults[0].value)  # type: ignore[arg-type]
    assert Fault("imu", "stuck", value=math.inf).value == math.inf
