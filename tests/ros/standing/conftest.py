"""One graph, with its default processes and actions, in which the tests of this folder find a G1 that stands."""

from collections.abc import Iterator

import pytest

from bridge.launch.layout import process_specs
from models.errors import PoiseError
from models.nodes.interfaces import missing_types
from tests.ros.conftest import Eyes, standing_graph


@pytest.fixture(scope="package")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Eyes]:
    """The graph of this folder."""
    with standing_graph(tmp_path_factory.mktemp("graph"), specs=process_specs(actions=not missing_types())) as seen:
        come_to_rest(seen)
        yield seen


def come_to_rest(seen: Eyes) -> None:
    """Wait for two simulated seconds: the base sways by 5 mm in the first one without support."""
    begin = seen.stamp
    seen.graph.wait_for(lambda: seen.stamp - begin > 2 * 10**9, 60.0, "at rest")


@pytest.fixture
def eyes(running: Eyes) -> Iterator[Eyes]:
    """The graph of this folder, in mode stand at the begin (also after a failed test) and at the end of a test."""
    try:
        running.graph.wait_standing(5.0)
    except PoiseError:
        assert running.ask("reset_faults")[0]
        assert running.ask("reset")[0]
        running.graph.wait_standing(90.0)
        come_to_rest(running)
    yield running
    running.graph.wait_for(
        lambda: running.graph.standing and running.reports["/supervisor"]["message"] == "mode 'stand'",
        10.0,
        "standing without a fault after the test",
    )
