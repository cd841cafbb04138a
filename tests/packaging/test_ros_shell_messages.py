"""The text of messages that the substitute of ``ros2`` prints."""

import pytest
from nav_msgs.msg import OccupancyGrid

from tests.ros_shell.ros2_messages import ITEMS_MAX, field_of, text_of

pytestmark = pytest.mark.ros


def test_one_field_is_printed_as_ros2_does() -> None:
    message = OccupancyGrid()
    message.info.resolution = 0.5
    assert text_of(field_of(message, "info.resolution")) == "0.5\n"
    message.header.frame_id = "waiting..."
    assert text_of(field_of(message, None)).splitlines()[4] == "  frame_id: waiting..."
    assert text_of(message.header).endswith("waiting...\n")
    for path, name in (("info.size", "size"), ("info.resolution.x", "x")):
        with pytest.raises(ValueError, match=f"--field {path}: there is no '{name}'"):
            field_of(message, path)


def test_a_long_sequence_shows_that_it_is_cut() -> None:
    lines = text_of(field_of(OccupancyGrid(data=[1] * (ITEMS_MAX + 1)), "data")).splitlines()
    assert lines == ["- 1"] * ITEMS_MAX + ["- '...'"]
