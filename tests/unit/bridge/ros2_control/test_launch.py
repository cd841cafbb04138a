"""Options of ``poise up --plant ros2_control``, and ``poise controllers``."""

import pytest
import yaml
from typer.testing import CliRunner

pytest.importorskip("rclpy")

from bridge.cli import app
from bridge.launch.hardware import hardware_options
from bridge.launch.layout import BRIDGE, process_specs
from bridge.plants.base import make_plant
from bridge.plants.config import read_options
from bridge.plants.ros2_control.config import read_config
from models.errors import ConfigError, MessageError
from models.robot_model import RobotModel

pytestmark = pytest.mark.ros


@pytest.fixture(autouse=True)
def graph_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")


def test_the_driver_and_the_guard_get_the_options() -> None:
    profile, given = hardware_options("ros2_control", "talos", "", 3, None, "{command: pvt, rate: 500.0}")
    assert profile == "talos_hardware"
    options = read_options(given["plant_options"])
    assert options == {"network_interface": "lo", "domain": 3, "command": "pvt", "rate": 500.0}
    assert given["rates"]["supervisor"] == {"sensor_rate": 500.0}
    options = "{command: pvt, rate: 500.0, domain: 3, network_interface: lo}"
    assert hardware_options("ros2_control", "talos", "", None, None, options)[1] == given
    guard, driver, *_ = given["robot_network"].processes(process_specs(), profile)
    assert guard.arguments[:3] == ("ros2_control", "talos_hardware", "3")
    assert read_options(guard.arguments[3]) == {"command": "pvt", "rate": 500.0}
    assert driver.module == BRIDGE.module and driver.environment == guard.environment


def test_the_rate_may_be_an_option_of_poise_up() -> None:
    _, given = hardware_options("ros2_control", "g1", "lo", 0, 250, "")
    assert given["rates"]["balance_controller"] == {"sensor_rate": 250.0}
    _, given = hardware_options("ros2_control", "g1", "lo", 0, None, "")
    assert given["rates"]["balance_controller"] == {"sensor_rate": 1000.0}
    _, given = hardware_options("unitree", "g1", "lo", 0, None, "")
    assert given["rates"]["balance_controller"] == {"sensor_rate": 500.0}


def test_a_slow_simulated_robot_gives_each_tick_more_time() -> None:
    _, given = hardware_options("unitree", "g1", "lo", 0, None, "{speed: 0.5}")
    assert given["rates"]["balance_controller"] == {"sensor_rate": 500.0, "time_budget": 0.004}
    assert given["rates"]["supervisor"] == {"sensor_rate": 500.0}
    _, given = hardware_options("unitree", "g1", "lo", 0, None, "{speed: 1}")
    assert given["rates"]["balance_controller"] == {"sensor_rate": 500.0}
    for options, reason in (("{speed: fast}", "speed: 'fast' is not"), ("{speed: 0.5, rate: 0.0}", "rate: 0.0 Hz")):
        with pytest.raises(ConfigError, match=reason):
            hardware_options("unitree", "g1", "lo", 0, None, options)


def test_the_end_may_be_an_option_of_the_plant_or_of_poise_up() -> None:
    for arguments in (
        ("ros2_control", "g1", "lo", 0, None, "{at_end: lower}"),
        ("unitree", "g1", "lo", 0, None, "", "lower"),
        ("booster", "t1.yaml", "lo", 0, None, "", "lower"),
    ):
        _, given = hardware_options(*arguments)  # type: ignore[arg-type]
        assert given["ending"].at_end == "lower" and "at_end" not in read_options(given["plant_options"])
    _, given = hardware_options("ros2_control", "g1", "lo", 0, None, "")
    assert given["ending"].at_end == "damp"


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("g1", "lo", 7, None, ""), "ROS domain 7 is that of the robot"),
        (("g1", "no0", 0, None, ""), "no interface 'no0'"),
        (("g1", "lo", 0, None, "{comand: pvt}"), "comand"),
        (("g1", "lo", 0, 500, "{rate: 1000.0}"), "--robot-rate 500.0 contradicts 'rate: 1000.0'"),
        (("g1", "lo", 0, None, "{domain: 3}"), "--robot-domain 0 contradicts 'domain: 3'"),
        (("g1", "lo", None, None, "{domain: x}"), "'x' is not a DDS domain"),
        (("g1", "lo", 0, None, "{network_interface: eth0}"), "--network-interface lo contradicts"),
        (("g1", "lo", 0, None, "{at_end: lower}", "damp"), "--at-end damp contradicts 'at_end: lower'"),
        (("g1", "lo", 0, None, "{at_end: fall}"), "at_end"),
        (("g1", "lo", 0, None, "{namespace: a b}"), "namespace"),
        (("g1", "lo", 0, None, "{controllers: {gripper: x}}"), "controllers.gripper"),
    ],
)
def test_wrong_options_are_refused_by_name(
    arguments: tuple[str, str, int | None, int | None, str], reason: str
) -> None:
    with pytest.raises(ConfigError, match=reason):
        hardware_options("ros2_control", *arguments)


def test_the_plant_is_made_by_its_name(g1: RobotModel) -> None:
    with pytest.raises(ConfigError, match="rate"):
        make_plant("ros2_control", g1, {"rate": 1.0})
    try:
        plant = make_plant("ros2_control", g1, {"domain": 9})
    except MessageError as error:
        pytest.skip(str(error))
    assert plant.period == 0.001
    plant.close()


def test_the_file_of_the_controllers_is_printed() -> None:
    result = CliRunner().invoke(app, ["controllers", "--robot", "g1", "--plant-options", "{command: pvt}"])
    assert result.exit_code == 0, result.output
    file = yaml.safe_load(result.output)
    assert "left_foot_broadcaster" not in file  # g1_hardware has no foot sensors
    assert len(file["whole_body_controller"]["ros__parameters"]["gpios"]) == 29
    assert CliRunner().invoke(app, ["controllers", "--plant-options", "{command: pv}"]).exit_code != 0
    given = "{namespace: robot_1}"
    file = yaml.safe_load(CliRunner().invoke(app, ["controllers", "--plant-options", given]).output)
    assert {"/robot_1/controller_manager", "/robot_1/whole_body_controller"} < set(file)


def test_the_namespace_is_before_every_name_that_is_not_absolute() -> None:
    config = read_config({"namespace": "robot_1", "topics": {"imu": "/imu/raw", "left_foot": "left/wrench"}})
    assert config.manager == "/robot_1/controller_manager"
    assert config.topic_of["joint_states"] == "/robot_1/joint_states"
    assert config.topic_of["command"] == "/robot_1/whole_body_controller/commands"
    assert (config.topic_of["imu"], config.topic_of["left_foot"]) == ("/imu/raw", "/robot_1/left/wrench")
    assert read_config({}).topic_of["imu"] == "/imu_sensor_broadcaster/imu"
    assert read_config({"controller_manager": "", "namespace": "robot_1"}).manager == ""
