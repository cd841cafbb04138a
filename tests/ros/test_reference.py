"""The reference of topics, services and parameters says what the nodes declare."""

import re
import sys
from pathlib import Path

import pytest

from models.nodes.interfaces import missing_types
from tests.reference import main

pytestmark = pytest.mark.ros


@pytest.mark.skipif(bool(missing_types()), reason="services with types of this project are part of the reference")
def test_the_reference_is_up_to_date(
    root: Path, tmp_path: Path, ros_domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "reference.md"
    monkeypatch.setattr(sys, "argv", ["reference", str(file)])
    main()
    assert file.read_text() == (root / "docs/reference.md").read_text(), "run `make reference`"


def test_no_node_offers_best_effort(root: Path) -> None:
    """The reference lists what each publisher offers."""
    topics = (root / "docs/reference.md").read_text(encoding="utf-8").partition("## Services")[0]
    assert not re.findall(r"^\| `([^`]+)` \| [^|]+ \| best effort", topics, re.MULTILINE)
