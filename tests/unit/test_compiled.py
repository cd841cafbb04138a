"""The cache of compiled kernels follows every kernel source."""

from __future__ import annotations

import shutil
from pathlib import Path

import numba

from models.compiled import source_hash

ROOT = Path(__file__).parents[2]


def test_a_change_of_any_kernel_changes_the_cache(tmp_path: Path) -> None:
    for package in ("models", "controllers"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    before = source_hash(tmp_path)
    assert before == source_hash(tmp_path)
    kernel = tmp_path / "controllers" / "qp" / "kernels_terms.py"
    kernel.write_text(kernel.read_text() + "\n# changed\n")
    assert source_hash(tmp_path) != before


def test_the_cache_in_use_is_that_of_these_sources() -> None:
    assert Path(numba.config.CACHE_DIR).name == source_hash(ROOT)


def test_every_kernel_compiles_through_it() -> None:
    for package in ("models", "planners", "controllers", "bridge"):
        for file in (ROOT / package).rglob("*.py"):
            assert "from numba import" not in file.read_text() or file.name == "compiled.py", file
