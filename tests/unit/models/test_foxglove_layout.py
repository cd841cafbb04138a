"""The layout for Foxglove names topics that there are, and every panel once."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
from models.nodes import topics


@pytest.fixture
def layout(root: Path) -> Any:
    return json.loads((root / "docs/foxglove/poise.json").read_text())


def panels(part: Any) -> list[str]:
    """Names of the panels in a tree of splits."""
    return [part] if isinstance(part, str) else [*panels(part["first"]), *panels(part["second"])]


def test_every_panel_has_its_place(layout: Any) -> None:
    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])


def test_every_topic_is_one_of_the_graph(layout: Any) -> None:
    known = {f"/{name.lstrip('/')}" for name in vars(topics).values() if isinstance(name, str)}
    known |= {f"/{name}" for name in (*topics.FOOT_WRENCHES, *topics.source_topics("teleop"))} | {"/diagnostics"}
    known |= {"/clicked_point", "/initialpose"}  # Foxglove's own, to which no node subscribes
    text = json.dumps(layout["configById"])
    named = set(re.findall(r'"(/[a-z_/]+?)(?:\.[a-z_.]+(?:\[\d+\])?)?"', text))
    assert len(named) > 10 and named <= known
