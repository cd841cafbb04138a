"""A user of ROS 2 with poise installed: launches a humanoid, looks at it, moves it, and ends it.

    python -m tests.ros_shell                  # installs this checkout into an environment of its own first
    python -m tests.ros_shell --prefix .venv   # what is installed there

Every command line and what came back is printed, and written as a table with ``--table FILE``. The ``ros2`` command
carries them out where there is one on the path (or ``--ros2 PATH``), elsewhere ``ros2.py``. The exit status is 0 only
when every step showed what it has to show.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
import venv
from contextlib import suppress
from pathlib import Path

from tests.ros_shell.shell import Shell
from tests.ros_shell.steps import BEFORE, LAUNCH, STEPS

HERE = Path(__file__).resolve().parent

STARTED, START_TIME = "drivers active", 400.0
"""What the launch says when the robot stands by itself, and how long that may take where all is compiled first [s]."""

STOP_TIME = 20.0
"""Longest wait for the end of the daemon [s]."""

FOREIGN = ("PYTHONPATH", "LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "VIRTUAL_ENV")
"""Variables that bring another environment's modules along, where no ROS 2 is sourced."""


def clean_environment() -> dict[str, str]:
    """This process's, without what would bring the checkout's modules along."""
    sourced = "ROS_DISTRO" in os.environ
    return {name: value for name, value in os.environ.items() if sourced or name not in FOREIGN}


def install(folder: Path) -> Path:
    """Install the checkout into an environment of its own, which takes its libraries from this one.

    Returns:
        Prefix of the environment.
    """
    prefix = folder / "environment"
    venv.create(prefix, with_pip=False)
    python = prefix / "bin/python"
    site = Path(sysconfig.get_path("purelib", vars={"base": str(prefix)}))
    loaded, modules = os.environ.get("LD_LIBRARY_PATH", ""), sysconfig.get_path("purelib")
    line = f"import os, site; os.environ.setdefault('LD_LIBRARY_PATH', {loaded!r}); site.addsitedir({modules!r})"
    (site / "libraries.pth").write_text(line + "\n")  # the wheels of ROS 2 look for their libraries in sys.prefix only
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--disable-pip-version-check"]
    pip += ["--no-deps", "--ignore-installed", "--no-build-isolation", str(HERE.parents[1])]
    for command in (pip, [str(python), "-m", "models.nodes.interface_build"]):
        subprocess.run(command, check=True, cwd=folder, env=clean_environment())
    return prefix


def shell_environment(prefix: Path, folder: Path) -> dict[str, str]:
    """A shell with a prefix and ROS 2 on the path, in a ROS domain of its own.

    Raises:
        SystemExit: It is not the installed poise that is imported, or types are missing; says which and why.
    """
    prefixes = (str(prefix), sysconfig.get_path("data"), os.environ.get("AMENT_PREFIX_PATH", ""))
    environment = clean_environment() | {
        "AMENT_PREFIX_PATH": os.pathsep.join(dict.fromkeys(each for each in prefixes if each)),
        "PYTHONUNBUFFERED": "1",
        "ROS_LOG_DIR": str(folder / "log"),
        "XDG_STATE_HOME": str(folder / "state"),
    }

    def ask(code: str) -> str:
        """What the installed Python answers."""
        command = [prefix / "bin/python", "-c", code]
        return subprocess.check_output(command, cwd=folder, env=environment, text=True).strip()

    imported = ask("import bridge; print(bridge.__file__)")
    if not Path(imported).is_relative_to(prefix):
        raise SystemExit(f"poise is not installed in {prefix}: {imported} is imported")
    if missing := ask("from models.nodes.interfaces import missing_types; print(missing_types())"):
        raise SystemExit(missing)
    environment["ROS_DOMAIN_ID"] = ask("from bridge.ros.environment import free_domain; print(free_domain())")
    if "ROS_DISTRO" in environment:  # its ros2 does not run in the environment that the types were built in
        types = Path(ask("import poise_interfaces; print(poise_interfaces.__file__)")).parents[1]
        environment["PYTHONPATH"] = os.pathsep.join((str(types), environment.get("PYTHONPATH", "")))
    return environment


def session(shell: Shell, launch: str) -> None:
    """Do every step.

    Args:
        shell: Where.
        launch: Command that launches the robot.
    """
    for step in BEFORE:
        shell.do(step)
    robot = shell.start(launch)
    try:
        stands = shell.wait(robot, (STARTED,), START_TIME)
        shell.say(launch, (STARTED,), "" if stands else "the robot does not stand", shell.output(robot))
        for step in STEPS if stands else ():
            shell.do(step)
    finally:
        code = shell.end(robot)
        shell.say(f"{launch}  # Ctrl-C", ("exit status 0",), "" if code == 0 else f"exit status {code}")


def main() -> int:
    """Install unless --prefix says where it is installed, and do every step."""
    parser = argparse.ArgumentParser(prog="python -m tests.ros_shell", description=str(__doc__).splitlines()[0])
    parser.add_argument("--prefix", type=Path, help="where poise is installed; an environment made for it otherwise")
    parser.add_argument("--ros2", default=shutil.which("ros2"), help="the ros2 command; that on the path otherwise")
    parser.add_argument("--table", type=Path, help="file for a table of command, expectation and what was seen")
    given = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(f"ended by signal {number}"))  # and the robot with it
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="poise_shell_") as name:
        folder = Path(name).resolve()
        prefix = given.prefix.resolve() if given.prefix else install(folder)
        environment = shell_environment(prefix, folder)
        ours = [str(prefix / "bin/python"), str(HERE / "ros2.py")]
        shell = Shell([given.ros2] if given.ros2 else ours, environment, folder)
        try:
            session(shell, LAUNCH)
        finally:
            if given.ros2:  # the daemon that its first command has started
                stop = [given.ros2, "daemon", "stop"]
                with suppress(subprocess.TimeoutExpired):
                    subprocess.run(stop, env=environment, cwd=folder, check=False, timeout=STOP_TIME)
    if given.table:
        given.table.write_text(shell.table(), encoding="utf-8")
    done = f"{len(shell.failed)} failed: {'; '.join(shell.failed)}" if shell.failed else "all steps worked"
    print(f"{done}; {given.ros2 or 'rclpy'}, {time.monotonic() - begin:.0f} s")
    return 1 if shell.failed else 0


if __name__ == "__main__":
    sys.exit(main())
