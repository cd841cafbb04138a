"""A fall leaves a file with what led to it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from bridge.cli import app
from bridge.closed_loop import ClosedLoop
from controllers.black_box_file import BlackBoxRecord
from models.types import Mode


def test_a_fall_leaves_a_black_box(tmp_path: Path) -> None:
    loop = ClosedLoop(robot="g1", seed=0, record=False, black_box=tmp_path)
    loop.run(0.5)
    loop.apply_push((400.0, 0.0, 0.0), duration=0.2)
    for _ in range(30):
        loop.run(0.1)
        if loop.black_box is not None and loop.black_box.files:
            break
    assert loop.mode is Mode.DAMP and loop.black_box is not None
    (file,) = loop.black_box.files
    assert list(tmp_path.iterdir()) == [file]
    record = BlackBoxRecord.load(file)
    assert record.reason == "; ".join(loop.faults)
    # Every tick from the start (it has not run for 10 s) to half a second after the fault.
    np.testing.assert_allclose(np.diff(record.t), 0.001, atol=1e-9)
    damped = [t for t, text in record.events if text.startswith("mode damp")]
    assert len(damped) == 1 and any(text.startswith("push") for _, text in record.events)
    begin = next(t for t, text in loop.events if text == "released")
    assert record.t[0] <= begin and 0.49 < record.t[-1] - damped[0] < 0.53
    modes = np.array([mode is Mode.DAMP for mode in record.modes])
    assert record.t[modes][0] - damped[0] < 0.005
    assert np.isfinite(record.command_tau[~modes]).all() and np.isnan(record.command_tau[modes]).all()
    assert np.isfinite(record.gyro).all() and np.abs(record.gyro).max() > 0.5  # it falls
    out = tmp_path / "pictures"
    drawn = CliRunner().invoke(app, ["log", "black-box", str(file), "--out", str(out)])
    assert drawn.exit_code == 0 and record.reason[:30] in drawn.output, drawn.output
    assert {picture.name for picture in out.iterdir()} == {"black_box.png", "balance.png", "torques.png"}
    assert all(picture.stat().st_size > 20_000 for picture in out.iterdir())
    loop.reset()
    loop.run(0.1)
    assert len(loop.black_box.files) == 1 and len(loop.black_box.box) < len(record.t)
