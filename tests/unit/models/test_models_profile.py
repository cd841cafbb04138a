"""Profiles: what is accepted, and that every refusal names the file and the key."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from controllers.whole_body.config import load_balance_config, load_whole_body_config
from models.errors import ConfigError, RobotModelError
from models.profile import load_profile, robot_names
from models.robot_model import RobotModel
from planners.gait.scaling import load_gait_config

Write = Callable[[dict[str, Any]], Path]


@pytest.fixture
def g1_data(root: Path) -> dict[str, Any]:
    data = yaml.safe_load((root / "models" / "robots" / "g1.yaml").read_text())
    assert isinstance(data, dict)
    return data


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def _write(data: dict[str, Any]) -> Path:
        path = tmp_path / "mine.yaml"
        path.write_text(yaml.safe_dump(data))
        return path

    return _write


def test_packaged_robots_are_listed() -> None:
    assert robot_names() == ["g1", "g1_hardware", "g1_mode_2_hardware", "talos", "talos_hardware"]


def test_copy_of_a_profile_loads_by_path(g1_data: dict[str, Any], write: Write) -> None:
    path = write(g1_data)
    assert load_profile(path).source == str(path)
    assert load_profile(str(path)).name == "g1"
    assert RobotModel.load(path).nj == 29


def test_unknown_robot_lists_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"'hal'.*g1, g1_hardware, g1_mode_2_hardware, talos, talos_hardware"):
        load_profile("hal")


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.yaml: cannot be read"):
        load_profile(tmp_path / "nowhere.yaml")


def _set(*keys: str, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        for key in keys[:-1]:
            data = data[key]
        data[keys[-1]] = value

    return change


def _delete(*keys: str) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        for key in keys[:-1]:
            data = data[key]
        del data[keys[-1]]

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_set("colour", value="red"), "colour"),
        (_delete("frames", "scan"), "'scan' is missing, where sensors.scan is mounted"),
        (_set("sensors", "scan", "angle_max", value=-4.0), "must span more than 0, at most a turn"),
        (_set("sensors", "scan", "angle_max", value=3.2), "must span more than 0, at most a turn"),
        (_set("sensors", "scan", "range_min", value=12.0), "range_min 12.0 m is not below range_max"),
        (_set("sensors", "scan", "rays", value=1), r"sensors\.scan\.rays"),
        (_set("sensors", "imu", "temperature", value=1.0), r"sensors\.imu\.temperature"),
        (_set("motors", "unitree_5020", "kp", value="strong"), r"motors\.unitree_5020\.kp"),
        (_set("motors", "unitree_5020", "armature", value=-1.0), r"motors\.unitree_5020\.armature"),
        (_set("motors", "unitree_5020", "torque_rate", value=0.0), r"motors\.unitree_5020\.torque_rate"),
        (_delete("motors", "unitree_5020", "kd"), r"motors\.unitree_5020\.kd"),
        (_delete("feet", "right"), r"feet\.right"),
        (_set("feet", "left", "rectangle", value=[0.1, -0.1, -0.03, 0.03]), r"feet\.left.*x_min < x_max"),
        (_set("feet", "friction", value=0.0), r"feet\.friction"),
        (_set("joints", "left_knee_joint", "motor", value="steam"), "left_knee_joint.*unknown motor 'steam'"),
        (_set("joints", "left_knee_joint", "torque_limit", value=-5.0), r"joints\.left_knee_joint\.torque_limit"),
        (
            _set("joints", "left_knee_joint", "aliases", value=["l_elbow"]),
            "'left_knee_joint': 'l_elbow' is a name of 'left_elbow_joint' too",
        ),
        (_delete("frames", "gaze"), "'gaze' is missing"),
        (_set("frames", "l_sole", value={"link": "pelvis"}), "'l_sole' is defined by the loader"),
        (_delete("postures", "stand"), "'stand' is missing"),
        (_set("postures", "zero", value={}), "'zero' is built in"),
        (_set("postures", "stand", "tail_joint", value=0.1), "posture 'stand': unknown joint 'tail_joint'"),
        (_set("hulls", "head", "radius", value=0.0), r"hulls\.head\.radius"),
        (_set("source", value="/elsewhere"), "source"),
        (_set("name", value="G 1"), "name"),
    ],
)
def test_bad_yaml_is_refused(
    g1_data: dict[str, Any], write: Write, change: Callable[[dict[str, Any]], None], message: str
) -> None:
    change(g1_data)
    with pytest.raises(ConfigError, match=rf"(?s)mine\.yaml: .*{message}"):
        load_profile(write(g1_data))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_delete("joints", "waist_yaw_joint"), "joints: 'waist_yaw_joint' of .* is missing"),
        (_set("joints", "tail_joint", value={"motor": "unitree_5020"}), "joints: 'tail_joint' is not a moving joint"),
        (_set("frames", "gaze", "link", value="eye"), "frame 'gaze': link 'eye' does not exist"),
        (_set("feet", "left", "link", value="hoof"), "frame 'l_sole': link 'hoof' does not exist"),
        (_set("hulls", "head", "link", value="horn"), "hull 'head': link 'horn' does not exist"),
        (_set("base_link", value="torso_link"), "base_link: 'torso_link' is not the root link"),
        (_set("postures", "stand", "left_knee_joint", value=3.0), "'stand': joint 'left_knee_joint' at 3 rad"),
    ],
)
def test_profile_that_does_not_fit_its_urdf_is_refused(
    g1_data: dict[str, Any], write: Write, change: Callable[[dict[str, Any]], None], message: str
) -> None:
    change(g1_data)
    with pytest.raises(RobotModelError, match=rf"mine\.yaml: .*{message}"):
        RobotModel.load(write(g1_data))


def test_limits_and_gains_of_a_joint_replace_those_of_urdf_and_motor(g1_data: dict[str, Any], write: Write) -> None:
    g1_data["joints"]["left_knee_joint"] |= {"torque_limit": 7.0, "velocity_limit": 3.0, "kp": 11.0, "kd": 0.5}
    model = RobotModel.load(write(g1_data))
    left, right = model.joint_index("left_knee_joint"), model.joint_index("right_knee_joint")
    assert (model.tau_max[left], model.v_max[left], model.kp[left], model.kd[left]) == (7.0, 3.0, 11.0, 0.5)
    assert (model.tau_max[right], model.v_max[right]) == (139.0, 20.0)
    assert model.pin.effortLimit[6 + left] == 7.0


def test_a_profile_may_extend_another(write: Write, tmp_path: Path) -> None:
    above = write({"extends": "g1", "feet": {"friction": 0.5}, "laws": {"balance": {"dcm_gain": 4.0}}})
    profile, packaged = load_profile(above), load_profile("g1")
    assert (profile.name, profile.feet.friction, profile.source) == ("g1", 0.5, str(above))
    assert profile.feet.left == packaged.feet.left and profile.joints == packaged.joints
    (tmp_path / "top.yaml").write_text("{extends: mine.yaml, laws: {gait: {step_share: 0.8}}}")
    top = load_profile(tmp_path / "top.yaml")
    assert top.feet.friction == 0.5 and top.laws == {"balance": {"dcm_gain": 4.0}, "gait": {"step_share": 0.8}}
    assert RobotModel(top).urdf == RobotModel(packaged).urdf


def test_a_profile_that_extends_itself_is_refused(write: Write, tmp_path: Path) -> None:
    (tmp_path / "other.yaml").write_text("extends: mine.yaml")
    for name in ("mine.yaml", "other.yaml"):
        with pytest.raises(ConfigError, match="extends this profile"):
            load_profile(write({"extends": name}))


def test_the_laws_of_a_profile_change_those_of_the_robot(write: Write) -> None:
    packaged = RobotModel.load("g1")
    laws = {"gait": {"swing": {"freeze": 0.05}}, "balance": {"dcm_gain": 4.0}, "whole_body": {"com": {"kp": 70.0}}}
    model = RobotModel.load(write({"extends": "g1", "laws": laws}))
    gait, before = load_gait_config(model), load_gait_config(packaged)
    assert gait == replace(before, swing=replace(before.swing, freeze=0.05))
    assert load_balance_config(model) == replace(load_balance_config(packaged), dcm_gain=4.0)
    assert load_whole_body_config(model).com.kp == 70.0
    assert load_whole_body_config(model).foot == load_whole_body_config(packaged).foot


@pytest.mark.parametrize(
    ("laws", "message"),
    [
        ({"gait": {"swing": {"frozen": 1.0}}}, r"laws.gait: swing.frozen: Unexpected keyword argument"),
        ({"gait": {"step_share": 2.0}}, r"laws.gait: step_share: Input should be less than or equal to 1"),
        ({"estimator": {}}, r"laws.estimator.*: Input should be 'gait', 'balance' or 'whole_body'"),
    ],
)
def test_laws_that_do_not_exist_are_named(write: Write, laws: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_gait_config(RobotModel.load(write({"extends": "g1", "laws": laws})))


def test_a_urdf_in_another_encoding_is_loaded(tmp_path: Path, write: Write, g1: RobotModel) -> None:
    robot = g1.description[g1.description.index("<robot") :]
    text = f'<?xml version="1.0" encoding="latin-1"?>\n<!-- modèle -->\n{robot}'
    (tmp_path / "other.urdf").write_text(text, encoding="latin-1")
    model = RobotModel.load(write({"extends": "g1", "urdf": str(tmp_path / "other.urdf")}))
    assert model.joint_names == g1.joint_names and "<!-- mod\ufffdle -->" in model.description
