"""``poise``: the command line. Each command imports the modules that it needs, so that help appears at once."""

import os
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperGroup

from bridge.commands import record
from bridge.commands.common import Namespace, Network, console, need, need_ros, say, signer_of
from bridge.commands.robot import calibrate, hang, identify, mode, reach, reset, send, start, status, walk
from models.errors import PoiseError
from models.numerics.threads import use_one_thread

ENTRY_POINTS = "poise.commands"  #: Entry points of further commands, such as ``poise bench``

# One thread per process, set before numerical libraries are imported; MuJoCo renders without a display.
use_one_thread()
os.environ.setdefault("MUJOCO_GL", "egl")


class _Commands(TyperGroup):
    """Commands of poise and of other packages; the latter are loaded from entry points on demand.

    A ``PoiseError`` ends a command with its text in one line and exit status 2.
    """

    def list_commands(self, ctx: Any) -> list[str]:
        from importlib.metadata import entry_points

        return [*super().list_commands(ctx), *sorted(entry_points(group=ENTRY_POINTS).names)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        from importlib.metadata import entry_points

        if cmd_name not in self.commands:
            for entry in entry_points(group=ENTRY_POINTS, name=cmd_name):
                command = typer.main.get_command(entry.load())
                command.name = cmd_name
                self.add_command(command)
        return super().get_command(ctx, cmd_name)

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except PoiseError as error:
            typer.secho(str(error), fg="red", err=True)
            raise typer.Exit(2) from error


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_show_locals=False,
    help="Whole-body control for humanoid robots over ROS 2.",
)
app.add_typer(record.log_app, name="log")


def _robots() -> list[str]:
    from models.profile import robot_names

    return list(robot_names())


Robot = Annotated[str, typer.Option(help="Robot profile, by name or path.", autocompletion=_robots)]
RunningRobot = Annotated[str, typer.Option(help="Robot profile; by default that of the running robot.")]
Key = Annotated[Path | None, typer.Option(help="Sign commands with the key in this file.")]


def _print_version(requested: bool) -> None:
    if requested:
        from importlib.metadata import version

        print(f"poise {version('poise')}")
        raise typer.Exit


@app.callback()
def _options(
    _: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Options of the command line itself."""


@app.command()
def demo(
    robot: Robot = "g1",
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for report, plots, film strip and recording; by default out or out/stairs, by scene."
        ),
    ] = None,
    scene: Annotated[
        Literal["square", "stairs"],
        typer.Option(help="Wave, squat, push and a square; or stairs that the robot maps with its range sensors."),
    ] = "square",
) -> None:
    """Stand, wave, squat, take a push and walk a square over ROS 2, and report how well."""
    need_ros()
    if scene == "stairs":
        from bridge.demo.stairs import demo_stairs

        raise typer.Exit(demo_stairs(robot, out or Path("out", scene)))
    from bridge.demo.run import demo as play

    raise typer.Exit(play(robot, out or Path("out")))


@app.command()
def up(
    robot: Robot = "g1",
    duration: Annotated[float | None, typer.Option(min=0.0, help=r"Stop after this time \[s].")] = None,
    network: Annotated[bool, typer.Option(help="Communicate with other machines; by default loopback only.")] = False,
    processes: Annotated[
        Literal["shared", "separate"],
        typer.Option(help="Gait planner, controller and estimator in one process, or every node in a separate one."),
    ] = "shared",
    merged: Annotated[bool, typer.Option(hidden=True)] = True,
    lockstep: Annotated[bool, typer.Option(help="The plant waits for the command of every tick.")] = False,
    sensor_errors: Annotated[
        str, typer.Option(help="Further errors of the simulated sensors: a YAML file, or YAML in braces.")
    ] = "",
    faults: Annotated[
        str,
        typer.Option(
            help="Faults, injected when the robot stands: a YAML file, a scenario such as dead_knee, or YAML in braces."
        ),
    ] = "",
    terrain: Annotated[
        str, typer.Option(help="Ground: flat, tiles, slope_up, ...; models/config/terrain.yaml.")
    ] = "flat",
    expected_friction: Annotated[
        float,
        typer.Option(min=0.0, max=2.0, help="Expected friction coefficient of the ground; 0: that of the profile."),
    ] = 0.0,
    calibration: Annotated[
        Path | None,
        typer.Option(help="Folder of the calibration files; the user's by default, temporary with sensor errors."),
    ] = None,
    actions: Annotated[bool, typer.Option(help="Offer actions, in a separate process.")] = True,
    camera: Annotated[bool, typer.Option(help="Render the robot's camera, in a separate process.")] = False,
    terrain_map: Annotated[
        bool, typer.Option(help="Cast depth camera and lidar, and map the ground, in three separate processes.")
    ] = False,
    given_map: Annotated[
        Path | None, typer.Option(help="Prior map of the ground: a YAML file, as poise map writes it.")
    ] = None,
    motions: Annotated[Path | None, typer.Option(help="Folder of further motion files.")] = None,
    params_file: Annotated[
        Path | None, typer.Option(help="ROS parameter file: further parameters of the nodes.")
    ] = None,
    namespace: Annotated[str, typer.Option(help="Namespace of every node, topic and service, such as robot_1.")] = "",
    robots: Annotated[
        str, typer.Option(help="Several robots in one world, by namespace: robot_1=g1,robot_2=talos.", metavar="LIST")
    ] = "",
    place: Annotated[
        list[str] | None,
        typer.Option(help=r"Start of one of several robots \[m, m, rad]: robot_2=1,-1.5,0.", metavar="…"),
    ] = None,
    speed: Annotated[float, typer.Option(min=0.01, max=1.0, help="Ratio of simulated to real time.")] = 1.0,
    real_time: Annotated[
        Literal["yield", "strict"],
        typer.Option(help="Whether simulated time waits for late nodes (yield) or not (strict)."),
    ] = "yield",
    plant: Annotated[
        str,
        typer.Option(help="Plant: mujoco, unitree, booster, ros2_control, an installed one, or module:Class."),
    ] = "mujoco",
    plant_options: Annotated[
        str, typer.Option(help="Options of another plant than mujoco: YAML in braces, or a file.")
    ] = "",
    network_interface: Annotated[
        str, typer.Option(help="Network interface to a real robot, such as eth0.", metavar="IF")
    ] = "",
    robot_domain: Annotated[
        int | None, typer.Option(min=0, max=232, help="DDS domain of a real robot; 0 by default.")
    ] = None,
    robot_rate: Annotated[
        int | None, typer.Option(help=r"Rate of states and commands of a real robot \[Hz]; with unitree 500 or 1000.")
    ] = None,
    at_end: Annotated[
        Literal["damp", "lower"] | None,
        typer.Option(help="Effect of Ctrl-C on a real robot: damp it, or lower it first; a second Ctrl-C damps it."),
    ] = None,
) -> None:
    """Run the real-time graph until Ctrl-C."""
    need_ros()
    from bridge.launch.graph import own_motions
    from bridge.launch.graph import up as launch
    from bridge.launch.parameters import with_file
    from bridge.launch.world import inhabitants, up_world
    from bridge.plants.base import find_plant
    from bridge.plants.fault_plan import fault_plan
    from bridge.plants.sensors import read_sensor_errors
    from models.calibration_store import calibration_directory
    from models.errors import ConfigError
    from models.profile import load_profile
    from models.terrain import FLAT, terrain_named

    read_sensor_errors(sensor_errors)
    fault_plan(faults)
    terrain_named(terrain)
    several = inhabitants(robots, place or (), motions)
    for each in [one.robot for one in several.values()] or [robot]:
        load_profile(each)  # otherwise every node refuses it half a minute later
    own = {} if motions is None or several else own_motions(robot, motions)
    if several and namespace:
        raise typer.BadParameter("--namespace is for one robot only: --robots sets the namespace of each")
    if several and camera:
        raise typer.BadParameter("--camera is for one robot only: its image does not show the others")
    if terrain_map and (several or plant != "mujoco"):
        raise typer.BadParameter(
            "--terrain-map is for one simulated robot only; otherwise start terrain_mapper separately"
        )
    if terrain_map:
        sensors = load_profile(robot).sensors
        if sensors.depth is None and sensors.lidar is None:
            raise ConfigError(
                f"--terrain-map: {robot} has neither sensors.depth nor sensors.lidar; add one to its profile, or"
                " start without --terrain-map"
            )
    if given_map is not None:
        if several:
            raise typer.BadParameter("--given-map is for one robot only")
        from planners.terrain.given_map import load_given_map

        load_given_map(given_map)
    if several and plant != "mujoco":
        raise typer.BadParameter("--plant is for one robot only: several robots share one world of mujoco")
    if plant == "mujoco" and plant_options:
        raise typer.BadParameter("--plant-options is for plants other than mujoco: give --plant")
    if plant != "mujoco" and (sensor_errors or faults or terrain != FLAT):
        raise typer.BadParameter(
            "--sensor-errors, --faults and --terrain need --plant mujoco; for faults of a real robot: poise rehearse"
        )
    hardware: dict[str, Any] = {}
    from bridge.launch.hardware import PLANTS, check_plant, hardware_options, other_network

    if plant in PLANTS:
        robot, hardware = hardware_options(
            plant, robot, network_interface, robot_domain, robot_rate, plant_options, at_end
        )
        plant_options = hardware.pop("plant_options")
        check_plant(plant, robot, plant_options)
        if speed != 1.0 or lockstep or camera:
            raise typer.BadParameter(
                "--speed, --lockstep and --camera are for simulated robots only; with poise rehearse --speed S, give "
                "--plant-options '{speed: S}'"
            )
    elif network_interface or at_end or robot_domain is not None or robot_rate is not None:
        find_plant(plant)  # reports a misspelt name first
        raise typer.BadParameter(
            "--network-interface, --robot-domain, --robot-rate, --at-end need --plant " + " or ".join(PLANTS)
        )
    if calibration is None and not sensor_errors:
        calibration = calibration_directory() / plant.replace(":", ".")  # one folder for each plant
    given = {"sensor_errors": sensor_errors, "faults.plan": faults, "plant_options": plant_options}
    driver = {"plant": plant, "terrain": terrain, "speed": speed, "real_time": real_time} | {
        k: text for k, text in given.items() if text
    }
    options: dict[str, Any] = {
        "duration": duration,
        "network": network,
        "processes": processes if merged else "separate",
        "lockstep": lockstep,
        "parameters": {
            "robot_driver": driver,
            "state_estimator": {"friction.expected": expected_friction},
            **({"camera_node": {"terrain": terrain}} if camera else {}),
            **({"range_sensor_node": {"terrain": terrain}} if terrain_map else {}),
            **({"terrain_mapper": {"given_map": str(given_map.resolve())}} if given_map is not None else {}),
            **own,
        },
        "calibration": calibration,
        "actions": actions,
    }
    if plant not in (*PLANTS, "mujoco"):
        options["robot_network"] = other_network(plant, plant_options)
    if hardware:
        options["parameters"].update({name: {**own.get(name, {}), **more} for name, more in hardware["rates"].items()})
        options |= {name: hardware[name] for name in ("robot_network", "ending")}
    if params_file is not None:
        options["parameters"] = with_file(options["parameters"], params_file)
    raise typer.Exit(
        up_world(several, **options)
        if several
        else launch(
            robot,
            namespace=namespace,
            camera=camera,
            terrain_map=terrain_map,
            given_map=given_map is not None,
            **options,
        )
    )


@app.command()
def view(
    robot: RunningRobot = "",
    host: Annotated[
        str, typer.Option(help="Address to listen on; 0.0.0.0 for all addresses of this machine.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="TCP port to listen on.")] = 8080,
    key: Key = None,
    network: Network = False,
    namespace: Namespace = "",
) -> None:
    """Show the running robot in a browser, with buttons, sticks, plots and gains; Ctrl-C ends the page."""
    need_ros()
    need("viser", "pip install 'poise[view]'")
    from bridge.view.page import view as serve

    if key is not None and host not in ("127.0.0.1", "localhost"):
        raise typer.BadParameter(
            "--key needs --host 127.0.0.1: otherwise others on the network could send signed commands"
        )
    serve(robot=robot, host=host, port=port, network=network, namespace=namespace, signer=signer_of(key))


@app.command()
def teleop(
    robot: RunningRobot = "",
    gamepad: Annotated[Path | None, typer.Option(help="Device, such as /dev/input/js0; keys by default.")] = None,
    key: Key = None,
    network: Network = False,
    namespace: Namespace = "",
) -> None:
    """Steer the running robot by keys of the terminal or a gamepad, on /commands/teleop."""
    need_ros()
    from bridge.teleop import teleop as steer

    steer(robot, gamepad=gamepad, network=network, namespace=namespace, signer=signer_of(key))


@app.command()
def key(file: Annotated[Path, typer.Argument(help="File to write; an existing file is never overwritten.")]) -> None:
    """Make a key for signed commands: random bytes that this user alone can read."""
    from controllers.commands.command_signature import write_key

    write_key(file)
    console().print(f"{file}: new key; copy it to the robot and its operators, and keep it secret", markup=False)


@app.command("map")
def map_ground(
    terrain: Annotated[str, typer.Argument(help="Ground: flight, tiles, stones, ...; models/config/terrain.yaml.")],
    file: Annotated[Path, typer.Argument(help="YAML file to write, with a PNG of the heights beside it.")],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Overwrite an existing map.")] = False,
) -> None:
    """Write the map of a simulated ground, for poise up --given-map."""
    from models.terrain import terrain_named
    from planners.terrain.given_map import save_given_map, terrain_heights

    image = save_given_map(file, terrain_heights(terrain_named(terrain)), overwrite=overwrite)
    console().print(f"{file}: heights of '{terrain}', with {image}", markup=False)


@app.command("check-robot")
def check_robot(
    urdf: Annotated[Path, typer.Argument(help="URDF or MJCF of a robot that has no profile yet.")],
    out: Annotated[Path | None, typer.Option(help="The proposed profile; NAME.yaml in this folder by default.")] = None,
    package_dir: Annotated[
        list[Path] | None, typer.Option(help="Folder that contains packages of package:// URIs; repeatable.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Overwrite an existing profile.")] = False,
) -> None:
    """Propose a profile for a URDF or MJCF; stand, squat, wave and walk with it; say what is missing or wrong."""
    from bridge.check_robot import check_robot as check
    from bridge.check_robot import report

    verdict = check(urdf, out or Path(f"{urdf.stem}.yaml"), package_dir or (), overwrite=overwrite)
    report(verdict, console())
    raise typer.Exit(0 if verdict.passed else 1)


@app.command()
def robots() -> None:
    """List the robots that have a profile."""
    import pinocchio as pin
    from rich.table import Table

    from models.profile import robot_names
    from models.robot_model import RobotModel

    table = Table("name", "joints", r"mass \[kg]", r"CoM height \[m]", r"sole \[cm]")
    for name in robot_names():
        model = RobotModel.load(name)
        x_min, x_max, y_min, y_max = model.feet[0].rectangle
        sole = f"{100 * (x_max - x_min):.1f} x {100 * (y_max - y_min):.1f}"
        height = pin.centerOfMass(model.pin, model.data(), model.standing_configuration())[2]
        table.add_row(name, str(model.nj), f"{model.mass:.1f}", f"{height:.3f}", sole)
    console().print(table)


@app.command()
def joints(robot: Robot = "g1") -> None:
    """List the joints of a robot: names, aliases and limits."""
    from rich.table import Column, Table

    from models.robot_model import RobotModel

    model = RobotModel.load(robot)
    joint = Column("joint", no_wrap=True)
    limits = ("q\n\\[rad]", "v\n\\[rad/s]", "tau\n\\[N.m]")
    table = Table(joint, Column("aliases", overflow="fold"), *limits, box=None, pad_edge=False, collapse_padding=True)
    for i, name in enumerate(model.joint_names):
        aliases = (name.removesuffix("_joint"), *model.profile.joints[name].aliases)
        position = f"{model.q_lower[i]:.2f} to {model.q_upper[i]:.2f}"
        table.add_row(name, ", ".join(aliases), position, f"{model.v_max[i]:.1f}", f"{model.tau_max[i]:.0f}")
    console(soft_wrap=True).print(table)


@app.command()
def controllers(
    robot: Robot = "g1",
    plant_options: Annotated[str, typer.Option(help="Options of the plant: YAML in braces, or a file.")] = "",
) -> None:
    """Print the parameter file of the controller manager for a robot with --plant ros2_control."""
    need_ros()
    from bridge.launch.hardware import PROFILES
    from bridge.plants.config import read_options
    from bridge.plants.ros2_control.config import read_config
    from bridge.plants.ros2_control.controllers_file import controllers_file
    from models.robot_model import RobotModel

    model = RobotModel.load(PROFILES.get(robot, robot))
    text = controllers_file(model, read_config(read_options(plant_options)))
    say(text, nl=False)


_of_robot = (send, mode, start, status, reset, calibrate, identify, hang)
for _command in (record.record, record.replay, record.plot, record.export, *_of_robot):
    app.command()(_command)
for _numeric in (walk, reach):
    app.command(context_settings={"ignore_unknown_options": True})(_numeric)  # -0.3 is a number, not an option
