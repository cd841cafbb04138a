"""Why a walk ended: balance, load and tilt of the soles in its last moments."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from benchmarks.harness import Case
from bridge.closed_loop import ClosedLoop
from bridge.plots import COLOURS, new_figure

ROWS = 200
"""Most rows that are kept."""


def last_moments(loop: ClosedLoop, duration: float) -> Case:
    """The end of a robot's log, in the frame of its heading at each moment.

    Args:
        loop: The robot.
        duration: How much of it [s].

    Returns:
        Lists of numbers: ``t`` [s]; ``dcm``, ``zmp`` (as commanded) and the soles ``left`` and ``right``, forward and
        left of the CoM [m]; ``loads`` of both soles [N]; ``tilts`` of both soles [rad].
    """
    log, model = loop.log, loop.robot
    rows = np.flatnonzero(log.t >= log.t[-1] - duration)
    rows = rows[:: max(len(rows) // ROWS, 1)]
    data = model.data()
    places, tilts = np.empty((len(rows), 4, 2)), np.empty((len(rows), 2))
    for i, row in enumerate(rows):
        pin.framesForwardKinematics(model.pin, data, log.true_q[row])
        heading = data.oMi[1].rotation[:2, 0]
        forward = heading / np.linalg.norm(heading)
        turn = np.array([forward, [-forward[1], forward[0]]])
        soles = [data.oMf[foot.frame_id] for foot in model.feet]
        # The laws' points are in their own frame, which drifts: they are seen from their own CoM.
        places[i, 0] = turn @ (log.dcm[row] - log.com[row, :2])
        places[i, 1] = turn @ (log.zmp[row] - log.com[row, :2])
        for k, sole in enumerate(soles):
            places[i, 2 + k] = turn @ (sole.translation[:2] - log.true_com[row, :2])
            tilts[i, k] = np.arccos(np.clip(sole.rotation[2, 2], -1.0, 1.0))
    return {
        "t": log.t[rows].tolist(),
        **{name: places[:, k].tolist() for k, name in enumerate(("dcm", "zmp", "left", "right"))},
        "loads": log.wrenches[rows][:, [2, 8]].tolist(),
        "tilts": tilts.tolist(),
    }


def draw_fall(moments: Case, title: str, file: Path) -> None:
    """Draw what ``last_moments`` returned.

    Args:
        moments: What it returned.
        title: Above the picture.
        file: Where it goes.
    """
    figure = new_figure(8.0, 7.0)
    t = np.array(moments["t"])
    axes = [figure.add_subplot(4, 1, i + 1) for i in range(4)]
    for k, way in enumerate(("forward", "left")):
        for name, label in (("dcm", "DCM"), ("zmp", "ZMP")):
            axes[k].plot(t, np.array(moments[name])[:, k], color=COLOURS[label], label=label)
        for foot, style in (("left", "-"), ("right", "--")):
            axes[k].plot(
                t, np.array(moments[foot])[:, k], color="k", linewidth=0.8, linestyle=style, label=f"{foot} sole"
            )
        axes[k].set_ylabel(f"{way} of the CoM [m]", fontsize=8)
        axes[k].set_ylim(-0.5, 0.5)
    for k, (values, label) in enumerate(
        ((np.array(moments["loads"]), "load [N]"), (np.degrees(moments["tilts"]), "tilt of the sole [deg]"))
    ):
        axes[2 + k].plot(t, values[:, 0], "k-", t, values[:, 1], "k--", linewidth=0.8)
        axes[2 + k].set_ylabel(label, fontsize=8)
    axes[0].legend(fontsize=7, ncols=4)
    axes[0].set_title(title, fontsize=9)
    axes[3].set_xlabel("t [s]")
    figure.savefig(file, dpi=110)
