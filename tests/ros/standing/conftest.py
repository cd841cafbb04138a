"""One graph, with its default processes and actions, in which the tests of this folder find a G1 that stands."""

from collections.abc import Iterator

import pytest

from bridge.ros.processes import process_specs
from models.errors import PoiseError
from models.nodes.interfaces import missing_types
from tests.ros.conftest import Eyes, standing_graph


@pytest.fixture(scope="package")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Eyes]:
    """The graph of this folder."""
    with standing_graph(tmp_path_factory.mktemp("graph"), specs=process_specs(actions=not missing_types())) as seen:
        yield seen


@pytest.fixture
def eyes(running: Eyes) -> Eyes:
    """The graph of this folder, in mode stand whatever an earlier test has left."""
    try:
        running.graph.wait_standing(5.0)
    except PoiseError:
        assert running.ask("reset_faults")[0]
        assert running.ask("reset")[0]
        running.graph.wait_standing(90.0)
    return running
