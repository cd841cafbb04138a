"""Tests on machines with cables between them, skipped where network namespaces are not permitted."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from benchmarks.core.cable import isolation, plain_environment, run_program
from benchmarks.core.machine import Unavailable


def staged(
    scripts: Mapping[str, str], arguments: Sequence[str], folder: Path, root: Path, timeout: float = 150.0
) -> Any:
    """Run ``stage.py`` in a network namespace of its own, or skip the test where that is not permitted.

    Args:
        scripts: Texts by name, ``stage.py`` among them, which prints JSON on its last line.
        arguments: Of the stage.
        folder: Where the scripts are and run.
        root: Of the checkout.
        timeout: For the whole stage [s].

    Returns:
        The value of the JSON.
    """
    try:
        command = isolation()
    except Unavailable as error:
        pytest.skip(str(error))
    for name, text in scripts.items():
        (folder / name).write_text(text, encoding="utf-8")
    environment = plain_environment(root, folder)
    return run_program(["stage.py", *arguments], folder, environment, timeout=timeout, command=command)
