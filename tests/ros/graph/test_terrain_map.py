"""Range sensors and terrain mapper beside a standing robot, each killed and restarted alone."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.launch.layout import process_specs
from models.errors import MessageError
from models.nodes import topics
from models.nodes.grid_map import grid_map_type, layer_of
from models.nodes.qos import STATE
from tests.ros.conftest import Eyes, standing_graph

pytestmark = [pytest.mark.ros, pytest.mark.graph]

MODULES = ("planners.nodes.terrain_mapper", "planners.nodes.ground_planner", "bridge.nodes.range_sensor_node")


@pytest.fixture(scope="module")
def eyes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Eyes]:
    with standing_graph(tmp_path_factory.mktemp("graph"), specs=process_specs(terrain_map=True)) as seen:
        yield seen


@pytest.fixture(scope="module")
def maps(eyes: Eyes) -> list[Any]:
    try:
        kind = grid_map_type()
    except MessageError as error:
        pytest.skip(str(error))
    found: list[Any] = []
    eyes.graph.node.create_subscription(kind, topics.TERRAIN_MAP, found.append, STATE)
    return found


def ground_ahead(message: Any) -> np.ndarray:
    return layer_of(message, "elevation")[100:125, 60:90]  # 0.5 to 1 m ahead


def test_the_floor_is_mapped_from_the_robots_own_sensors(eyes: Eyes, maps: list[Any]) -> None:
    eyes.graph.wait_for(lambda: len(maps) > 3, 90.0, "mapping")
    ahead = ground_ahead(maps[-1])
    assert np.isfinite(ahead).mean() > 0.9 and np.sqrt(np.nanmean(ahead**2)) < 0.015
    readers = eyes.graph.node.get_subscriptions_info_by_topic(f"/{topics.GROUND_TRUTH}")
    assert "terrain_mapper" not in {info.node_name for info in readers}


@pytest.mark.parametrize("module", MODULES)
def test_each_is_restarted_alone_and_the_robot_stands(
    eyes: Eyes, maps: list[Any], undisturbed: None, module: str
) -> None:
    before = dict(eyes.graph.pids)
    os.kill(before[module], 9)
    eyes.graph.wait_for(lambda: eyes.graph.pids[module] != before[module], 120.0, "restarted")
    assert [name for name, pid in eyes.graph.pids.items() if pid != before[name]] == [module]
    maps.clear()
    eyes.graph.wait_for(lambda: len(maps) > 3, 90.0, "mapping again")
    assert np.sqrt(np.nanmean(ground_ahead(maps[-1]) ** 2)) < 0.015


def test_only_the_sensors_of_the_simulation_load_the_simulator(eyes: Eyes) -> None:
    loaded = {
        module
        for module, pid in eyes.graph.pids.items()
        if "libmujoco" in Path(f"/proc/{pid}/maps").read_text(encoding="utf-8")
    }
    assert loaded == {"bridge.nodes.robot_driver", "bridge.nodes.range_sensor_node"}
