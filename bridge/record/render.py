"""Film strip or animation of a recorded run, or of several robots in one world, drawn by MuJoCo without a display.

Run as ``python -m bridge.record.render [--profile PROFILE] [--terrain NAME] RECORDING... PICTURE`` in a separate
process, because broken OpenGL libraries crash the process that loads them. A picture named ``.gif`` is an animation.
"""

from __future__ import annotations

import argparse
import ctypes.util
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bridge.record.recording import Recording
from models.errors import PoiseError
from models.terrain import FLAT, Ground, terrain_named

if TYPE_CHECKING:
    from models.robot_model import RobotModel
    from models.types import Vector

FRAMES, ROWS = 12, 2  #: Pictures in a film strip, and rows of it [-]
STRIP_TIME = 120.0  #: Maximum time for a film strip [s]
FRAME_SIZE = (300, 480)  #: Width and height of one picture [pixel]
GIF_SIZE, GIF_RATE, GIF_SPEED = (160, 230), 6, 4.5  #: Animation: size [pixel], rate [1/s], ratio to real time [-]
GIF_COLORS = 32  #: Colours in the palette of an animation [-]
PROFILE = 90.0  #: Azimuth of the view of a robot on a terrain [deg]
RISER_TURN = 15.0  #: Turn from ``PROFILE`` to ahead [deg]; to behind where the ground rises, so that risers show
RISES = 0.05  #: Rise of the ground over one robot height ahead from which it counts as rising [m]
DONE = "done"  #: Last word of the events that end a part of the run
INPUT_ERROR = 3  #: Exit status for an unusable recording or profile
DARKEST = 0.2  #: Least value of each colour channel in a portrait [-]; a black robot would show no edges
PELVIS = 0.55  #: Ratio of the height of the pelvis to the height of the body [-]
GL_PACKAGES = "Debian and Ubuntu: sudo apt install libegl1 libgl1-mesa-dri"
GL_ADVICE = f"no pictures: EGL was not found; {GL_PACKAGES}"


def render_filmstrip(recording_file: Path, picture: Path, robot: str = "", *, terrain: str = FLAT) -> str:
    """Draw a film strip of a saved ``Recording`` in another process; returns the error, empty on success."""
    options = ["--profile", robot, "--terrain", terrain]
    return run_renderer("bridge.record.render", [*options, str(recording_file), str(picture)], picture, STRIP_TIME)


def run_renderer(module: str, arguments: Sequence[str], picture: Path, timeout: float) -> str:
    """Run a module that draws ``picture``, for at most ``timeout`` [s]; returns the error, empty on success."""
    if ctypes.util.find_library("EGL") is None:
        return GL_ADVICE
    try:
        result = subprocess.run(
            [sys.executable, "-m", module, *arguments],
            env=os.environ | {"MUJOCO_GL": "egl"},
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"no pictures: drawing took more than {timeout:.0f} s"
    if result.returncode == 0 and picture.is_file():
        return ""
    last = (result.stderr.strip().splitlines() or [f"exit status {result.returncode}"])[-1]
    if result.returncode == INPUT_ERROR:
        return f"no pictures: {last}"
    return f"no pictures: drawing failed: {last}; {GL_PACKAGES}"


def frame_times(recording: Recording, count: int = FRAMES) -> list[float]:
    """Increasing stamps to draw [s]: start, end, and the posture farthest from the initial one in each part of the run.

    A part lasts from an event to the next one. The remaining stamps, up to ``count`` (at least two), are those at 0.6
    of the deviation of these postures, then midpoints of the widest gaps.
    """
    t = recording.t
    deviation = np.linalg.norm(recording.q[:, 7:] - recording.q[0, 7:], axis=1) + np.abs(
        recording.q[:, 2] - recording.q[0, 2]
    )
    edges = [*(time for time, _ in recording.events), float(t[-1])]
    peaks, ways = [], []
    for (start, text), end in zip(recording.events, edges[1:], strict=True):
        part = np.flatnonzero((t >= start) & (t <= end))
        if len(part) == 0 or text.endswith(DONE):
            continue
        peak = int(part[np.argmax(deviation[part])])
        way = int(part[np.argmax(deviation[part] >= 0.6 * deviation[peak])])
        peaks.append(float(t[peak]))
        ways.append(float(t[way]))
    times = {float(t[0]), float(t[-1])}
    for candidate in (*peaks, *ways):
        if len(times) < count:
            times.add(candidate)
    result = sorted(times)
    while len(result) < count:
        gaps = np.diff(result)
        widest = int(np.argmax(gaps))
        result.insert(widest + 1, result[widest] + float(gaps[widest]) / 2.0)
    return result


def draw(recordings: Sequence[Recording], picture: Path, profile: str = "", terrain: str = FLAT) -> None:
    """Draw in this process; ``MUJOCO_GL`` must be set before MuJoCo is first imported.

    The recordings, one for each robot, have the same stamps; the events of the first are shown. The extension of
    ``picture`` selects PNG, JPEG or an animation (GIF); ``profile``, unless empty, replaces those of the recordings.
    """
    import mujoco
    from PIL import Image, ImageDraw, ImageFont

    from models.mujoco_model import build_mujoco, build_mujoco_world, pin_to_mujoco
    from models.robot_model import RobotModel

    robots = {str(number): RobotModel.load(profile or each.robot) for number, each in enumerate(recordings)}
    alone = len(robots) == 1
    world = (
        {"0": build_mujoco(robots["0"], visuals=True, terrain=terrain)}
        if alone
        else build_mujoco_world(robots, visuals=True, terrain=terrain)
    )
    ground = Ground(terrain_named(terrain))
    model, recording = world["0"].model, recordings[0]
    data = mujoco.MjData(model)
    animated = picture.suffix == ".gif"
    width, height = GIF_SIZE if animated else FRAME_SIZE
    t = recording.t
    if animated:
        times = list(np.arange(t[0], t[-1], GIF_SPEED / GIF_RATE))
    else:  # evenly spaced on a terrain
        times = frame_times(recording) if terrain == FLAT else np.linspace(t[0], t[-1], FRAMES).tolist()
    tall = max(float(each.q[0, 2]) for each in recordings) / PELVIS
    places = np.array([each.q[:, :2] for each in recordings])  # (robots, n, 2)
    spread = float(np.linalg.norm(np.ptp(places, axis=0), axis=1).max())
    camera = _camera(model, (width, height), tall + spread)
    font = ImageFont.load_default(size=10 if animated else 18)
    frames = []
    with mujoco.Renderer(model, height, width) as renderer:
        for time in times:
            index = min(int(np.searchsorted(t, time)), len(t) - 1)
            for name, each in zip(world, recordings, strict=True):
                mj = world[name]
                state = pin_to_mujoco(robots[name], mj, each.q[index], each.v[index])
                data.qpos[mj.qpos], data.qvel[mj.qvel] = state
            mujoco.mj_forward(model, data)
            x, y = places[:, index].mean(axis=0).tolist()
            camera.lookat[:] = x, y, 0.5 * tall + ground.height(x, y)
            if terrain != FLAT:
                rises = ground.height(x + tall, y) - ground.height(x, y) > RISES
                camera.azimuth = PROFILE - RISER_TURN if rises and not animated else PROFILE + RISER_TURN
            renderer.update_scene(data, camera)
            frame = Image.fromarray(renderer.render())
            happened = [text for stamp, text in recording.events if stamp <= time + 1e-6]
            label = f"{time:.1f} s  {happened[-1] if happened else ''}"
            ImageDraw.Draw(frame).text((8, 6), label, fill=(30, 40, 60), font=font)
            frames.append(frame)
    picture.parent.mkdir(parents=True, exist_ok=True)
    if animated:
        frames = [frame.quantize(GIF_COLORS, dither=Image.Dither.NONE) for frame in frames]
        frames[0].save(picture, save_all=True, append_images=frames[1:], duration=1000 // GIF_RATE, loop=0)
        return
    strip = Image.new("RGB", (width * FRAMES // ROWS, height * ROWS))
    for number, frame in enumerate(frames):
        row, column = divmod(number, FRAMES // ROWS)
        strip.paste(frame, (column * width, row * height))
    strip.save(picture)


def portrait(robot: RobotModel, q: Vector, size: tuple[int, int], label: str) -> Any:
    """Picture (PIL) of a robot with a label; ``size`` is width and height [pixel]. Needs ``MUJOCO_GL`` as ``draw``."""
    import mujoco
    from PIL import Image, ImageDraw, ImageFont

    from models.mujoco_model import build_mujoco, pin_to_mujoco

    world = build_mujoco(robot, visuals=True)
    data = mujoco.MjData(world.model)
    data.qpos[world.qpos], data.qvel[world.qvel] = pin_to_mujoco(robot, world, q, np.zeros(robot.nv))
    mujoco.mj_forward(world.model, data)
    colors = world.model.geom_rgba[:, :3]
    np.maximum(colors, DARKEST, out=colors)
    tall = float(q[2]) / PELVIS
    camera = _camera(world.model, size, tall)
    camera.lookat[:] = *q[:2], 0.5 * tall
    with mujoco.Renderer(world.model, size[1], size[0]) as renderer:
        renderer.update_scene(data, camera)
        picture = Image.fromarray(renderer.render())
    ImageDraw.Draw(picture).text((6, 4), label, fill=(30, 40, 60), font=ImageFont.load_default(size=12))
    return picture


def _camera(model: Any, size: tuple[int, int], extent: float) -> Any:
    """Camera for a scene with an extent [m]; ``size`` is width and height of the picture [pixel]."""
    import mujoco

    model.vis.global_.offwidth, model.vis.global_.offheight = size
    model.vis.map.shadowclip, model.vis.quality.shadowsize = 2.0, 4096  # a narrow, fine map: no speckles
    camera = mujoco.MjvCamera()
    camera.distance, camera.azimuth, camera.elevation = 1.45 * extent, 150.0, -12.0
    return camera


def main(arguments: list[str]) -> int:
    """Draw the picture named by the last argument from the recordings named before it."""
    parser = argparse.ArgumentParser(prog="python -m bridge.record.render")
    parser.add_argument("--profile", default="")
    parser.add_argument("--terrain", default=FLAT)
    parser.add_argument("recordings", type=Path, nargs="+")
    parser.add_argument("picture", type=Path)
    given = parser.parse_args(arguments)
    try:
        draw([Recording.load(file) for file in given.recordings], given.picture, given.profile, given.terrain)
    except PoiseError as error:
        print(error, file=sys.stderr)
        return INPUT_ERROR
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
