"""The guard process when its output is not read: a closed terminal, or one that was stopped."""

import os
import subprocess
import sys
from contextlib import suppress

import pytest

#: A driver that falls silent, and the guard beside it; its last words are whether its first command is stiff, as that
#: of the driver fades, and the stiffness after 200 commands. The pipe that it writes to is spoiled before.
SCRIPT = """
import os, sys, threading, time, types
import numpy as np
from bridge.nodes import damping_guard
from bridge.plants.hardware import RobotClock, session
from bridge.plants.unitree.codec import UnitreeCodec
from bridge.plants.unitree.guard import DampingGuard
from bridge.plants.unitree.wire import LOW_CMD
from models.robot_model import RobotModel
from models.types import JointCommand

model = RobotModel.load("g1_hardware")
zero, sent, taken = np.zeros(model.nj), [], [0]
stiff = JointCommand(model.posture("stand"), zero, zero, 4.0 * model.kp, model.kd)
command = UnitreeCodec(model, RobotClock(0.002, 2.0), session()).encode(stiff, 5)

class Link:
    def take(self):
        taken[0] += 1
        return [command] if taken[0] < 50 else []
    def send(self, data):
        sent.append(data)
        if len(sent) == 200:
            first, last = (LOW_CMD.read(each)["motor_cmd"]["kp"].max() for each in (sent[0], data))
            os.write(2, f"{first > 0.0} {last}".encode())
            os._exit(0)
    def beat(self, armed): pass
    def close(self): pass

package = types.ModuleType("fake")
package.connect = lambda *_: (DampingGuard(model), Link())
package.Plant = types.SimpleNamespace(guard_process="fake:connect")
sys.modules["fake"] = package
sys.stdin.read(1)
damping_guard.main(["fake:Plant", "g1_hardware", "0", "{}"])
"""


@pytest.mark.long
@pytest.mark.parametrize("reader", ["gone", "stopped"])
def test_the_guard_damps_where_its_output_is_not_read(reader: str) -> None:
    read, write = os.pipe()
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT], stdin=subprocess.PIPE, stdout=write, stderr=subprocess.PIPE, text=True
    )
    if reader == "gone":
        os.close(read)
    else:
        os.set_blocking(write, False)
        for size in (4096, 1):
            with suppress(BlockingIOError):
                while True:
                    os.write(write, bytes(size))
        os.set_blocking(write, True)
    try:
        _, error = process.communicate("x", timeout=60.0)
    finally:
        process.kill()
        os.close(write)
    assert error.splitlines()[-1] == "True 0.0"
