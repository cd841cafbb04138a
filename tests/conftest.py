"""Shared fixtures. Threads are pinned here, before a test imports anything numerical."""

from __future__ import annotations

import gc
import os
from collections.abc import Generator, Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from models.numerics.threads import use_one_thread

if TYPE_CHECKING:
    from models.robot_model import RobotModel

use_one_thread()
os.environ.setdefault("MUJOCO_GL", "egl")

ROOT = Path(__file__).resolve().parents[1]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Exempt imported objects from garbage collection, which otherwise takes a tenth of the test time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@cache
def _load_robot(name: str) -> RobotModel:
    from models.robot_model import RobotModel

    return RobotModel.load(name)


@pytest.fixture(scope="session", autouse=True)
def calibration_dir(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """No test reads or writes the user's calibration files."""
    folder = tmp_path_factory.mktemp("calibration")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("POISE_CALIBRATION_DIR", str(folder))
        yield folder


@pytest.fixture(scope="session", autouse=True)
def state_home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """No test writes black boxes among the user's."""
    folder = tmp_path_factory.mktemp("state")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(folder))
        yield folder


@pytest.fixture(scope="session")
def root() -> Path:
    """Root of the checkout."""
    return ROOT


@pytest.fixture(scope="session")
def g1() -> RobotModel:
    """The G1, loaded once a session."""
    return _load_robot("g1")


@pytest.fixture(scope="session")
def talos() -> RobotModel:
    """The TALOS, loaded once a session."""
    return _load_robot("talos")


@pytest.fixture(scope="session", params=["g1", "talos"])
def robot(request: pytest.FixtureRequest) -> RobotModel:
    """Each robot in turn, loaded once a session."""
    return _load_robot(request.param)


@pytest.fixture
def ros_domain_id(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[int]:
    """A ROS 2 domain that nothing else on this machine uses, set in the environment together with a log folder."""
    from bridge.ros.environment import free_domain

    domain = free_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_log"))
    yield domain
