"""Film strip of a recorded run, drawn by MuJoCo without a display.

Run as ``python -m bridge.render RECORDING PICTURE [PROFILE]`` in a process of its own: OpenGL libraries that are broken
end the process that loads them.
"""

from __future__ import annotations

import ctypes.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from bridge.recording import Recording
from models.errors import PoiseError

FRAMES, ROWS = 12, 2
"""Pictures in a film strip, and rows of it [-]."""

FRAME_SIZE = (300, 480)
"""Width and height of one picture [pixel]."""

DONE = "done"
"""Last word of the events that end a part of the run."""

NOT_OURS = 3
"""Exit status when the recording or the profile is at fault, and not the graphics."""

GL_ADVICE = "no pictures: EGL was not found; Debian and Ubuntu: sudo apt install libegl1 libgl1-mesa-dri"


def render_filmstrip(recording_file: Path, picture: Path, robot: str = "", *, timeout: float = 120.0) -> str:
    """Draw a film strip in another process.

    Args:
        recording_file: What ``Recording.save`` wrote.
        picture: PNG file to write.
        robot: Profile, by name or path; the one that the recording names when empty.
        timeout: How long drawing may take [s].

    Returns:
        Empty when the picture was written, else why not and which package brings what is missing.
    """
    if ctypes.util.find_library("EGL") is None:
        return GL_ADVICE
    command = [sys.executable, "-m", "bridge.render", str(recording_file), str(picture), robot]
    try:
        result = subprocess.run(
            command,
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
    if result.returncode == NOT_OURS:
        return f"no pictures: {last}"
    return f"{GL_ADVICE} (drawing failed: {last})"


def frame_times(recording: Recording, count: int = FRAMES) -> list[float]:
    """Stamps worth a picture: the beginning, the end, and in each part of the run the posture farthest from the first.

    A part lasts from an event to the next one. Where pictures are left, they show each part on its way to that posture,
    then the middle of the widest gaps.

    Args:
        recording: The run.
        count: How many, at least two.

    Returns:
        Increasing stamps [s].
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
        way = int(part[np.argmax(deviation[part] >= 0.6 * deviation[peak])])  # 0.6: well on the way, and not yet there
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


def draw(recording: Recording, picture: Path, robot: str = "") -> None:
    """Draw the film strip in this process; needs ``MUJOCO_GL`` set before MuJoCo is first imported.

    Args:
        recording: The run.
        picture: PNG file to write.
        robot: Profile, by name or path; the one that the recording names when empty.
    """
    import mujoco
    from PIL import Image, ImageDraw, ImageFont

    from models.mujoco_model import build_mujoco, pin_to_mujoco
    from models.robot_model import RobotModel

    model = RobotModel.load(robot or recording.robot)
    mj = build_mujoco(model, visuals=True)
    data = mujoco.MjData(mj.model)
    width, height = FRAME_SIZE
    mj.model.vis.global_.offwidth, mj.model.vis.global_.offheight = width, height
    camera = mujoco.MjvCamera()
    tall = float(recording.q[0, 2]) / 0.55  # the pelvis is a little above half the height of a human body
    camera.distance, camera.azimuth, camera.elevation = 1.45 * tall, 150.0, -12.0
    mj.model.vis.map.shadowclip, mj.model.vis.quality.shadowsize = 2.0, 4096  # a narrow, fine map: no speckles
    font = ImageFont.load_default(size=18)
    strip = Image.new("RGB", (width * FRAMES // ROWS, height * ROWS))
    with mujoco.Renderer(mj.model, height, width) as renderer:
        for number, time in enumerate(frame_times(recording)):
            index = min(int(np.searchsorted(recording.t, time)), len(recording.t) - 1)
            data.qpos[:], data.qvel[:] = pin_to_mujoco(model, mj, recording.q[index], recording.v[index])
            mujoco.mj_forward(mj.model, data)
            camera.lookat[:] = recording.q[index, 0], recording.q[index, 1], 0.5 * tall
            renderer.update_scene(data, camera)
            frame = Image.fromarray(renderer.render())
            happened = [text for stamp, text in recording.events if stamp <= time + 1e-6]
            label = f"{time - recording.t[0]:.1f} s  {happened[-1] if happened else ''}"
            ImageDraw.Draw(frame).text((8, 6), label, fill=(30, 40, 60), font=font)
            row, column = divmod(number, FRAMES // ROWS)
            strip.paste(frame, (column * width, row * height))
    picture.parent.mkdir(parents=True, exist_ok=True)
    strip.save(picture)


def main(arguments: list[str]) -> int:
    """Draw ``arguments[1]`` from the recording ``arguments[0]``, with the profile ``arguments[2]`` where given."""
    try:
        draw(Recording.load(Path(arguments[0])), Path(arguments[1]), *arguments[2:3])
    except (PoiseError, IndexError) as error:
        print(error, file=sys.stderr)
        return NOT_OURS
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
