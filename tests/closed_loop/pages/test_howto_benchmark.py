"""The benchmark of docs/howto_benchmark.md, made from the page alone: found, measured, judged, drawn."""

import re
from pathlib import Path

import pytest

from benchmarks import stability
from benchmarks.core import benchmark
from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Options
from models.errors import ConfigError


@pytest.fixture
def written(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of benchmarks that holds the page's two files."""
    page = (root / "docs/howto_benchmark.md").read_text()
    folder = tmp_path / "benchmarks"
    (settings,) = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    (module,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    for name, text in (("config/sway.yaml", settings), ("stability/sway.py", module)):
        (folder / name).parent.mkdir(parents=True)
        (folder / name).write_text(text)
        assert f"`benchmarks/{name}`" in page
    monkeypatch.setattr(benchmark, "ROOT", folder)
    monkeypatch.setattr(stability, "__path__", [*stability.__path__, str(folder / "stability")])
    return folder


@pytest.mark.long
def test_the_benchmark_of_the_page_works(written: Path, tmp_path: Path) -> None:
    (listed,) = catalogue(written).values()
    assert (listed.command, listed.info.seeds, listed.info.quick is not None) == ("sway", 3, True)
    bench = listed.load()
    report = bench.run(Options(seeds=1))
    assert 0.0 < report.figures["sway_max_m"] < 0.05 and report.passed
    assert report.notes[0].startswith("ok     sway_max_m ≤ 0.05: ")
    assert bench.plots(report, tmp_path)[0].stat().st_size > 1_000


def test_a_file_without_its_module_is_refused(written: Path) -> None:
    (written / "stability/sway.py").unlink()
    with pytest.raises(ConfigError, match=r"one module \*/sway.py expected, found 0"):
        catalogue(written)
