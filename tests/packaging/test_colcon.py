"""``colcon build`` of a workspace that holds this repository: ``ros2`` finds packages, executables and launch files."""

import os
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

COLCON = shutil.which("colcon")

PACKAGES = ("models", "planners", "controllers", "bridge", "poise")


def depends(manifest: Path) -> set[str]:
    """Packages that a ``package.xml`` says it needs to run."""
    return {str(each.text) for each in ElementTree.parse(manifest).iter("exec_depend")}


def test_the_workspace_package_needs_what_its_packages_need(root: Path) -> None:
    needed = set[str]().union(*(depends(root / package / "package.xml") for package in PACKAGES[:-1]))
    assert depends(root / "package.xml") == needed - set(PACKAGES)


@pytest.mark.slow
@pytest.mark.skipif(COLCON is None, reason="no colcon; pip install colcon-common-extensions")
@pytest.mark.skipif(shutil.which("cmake") is None, reason="no cmake; Debian and Ubuntu: sudo apt install cmake")
def test_a_workspace_is_built_and_sourced(root: Path, tmp_path: Path) -> None:
    pytest.importorskip("hatchling", reason="installing without network needs hatchling")
    (tmp_path / "src").mkdir()
    (tmp_path / "src/poise").symlink_to(root)
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "AMENT_PREFIX_PATH")}
    environment |= {"PATH": path, "COLCON_HOME": str(tmp_path / "home")}
    for _ in range(2):  # the second time over the first
        build = subprocess.run(
            [str(COLCON), "build"],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert build.returncode == 0, build.stdout + build.stderr
        stale = next((tmp_path / "install/poise/lib").glob("python*/site-packages/bridge")) / "stale.py"
        assert not stale.exists()
        stale.touch()
    script = ". install/setup.sh && echo $AMENT_PREFIX_PATH && python -c 'import bridge; print(bridge.__file__)'"
    sourced = ["sh", "-c", f"{script} && $AMENT_PREFIX_PATH/lib/bridge/poise --version"]
    result = subprocess.run(
        sourced, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True, timeout=60
    )
    prefix, module, version = result.stdout.split("\n")[:3]
    assert prefix == str(tmp_path / "install/poise")
    assert Path(module).is_relative_to(prefix) and version.startswith("poise ")
    for package in PACKAGES:
        assert (Path(prefix) / "share/ament_index/resource_index/packages" / package).is_file()
        assert (Path(prefix) / "share" / package / "package.xml").is_file()
    assert (Path(prefix) / "share/bridge/launch/humanoid.launch.py").is_file()
    for package, name in (("controllers", "supervisor"), ("planners", "motion_planner"), ("bridge", "robot_driver")):
        assert os.access(Path(prefix) / "lib" / package / name, os.X_OK)
