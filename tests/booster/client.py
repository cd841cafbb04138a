"""Booster's own client: the package ``booster-robotics-sdk-python`` reads the states, changes the mode and commands.

    python -m tests.booster.client ADDRESS DOMAIN

It prints in JSON what it found: modes, the newest state, and the mode after its request. Its commands bend both elbows.
"""

import json
import sys
import time
from typing import Any

import booster_robotics_sdk_python as sdk

ELBOWS = (4, 8)  #: Motors
ANGLE = 0.4  #: To which they are bent [rad]
LIMIT = 10.0  #: Time for each step [s]


def wait(condition: Any) -> None:
    """Wait until a condition holds, or for ``LIMIT``."""
    end = time.monotonic() + LIMIT
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)


def main(address: str, domain: int) -> None:
    """From the mode ``prepare`` to ``custom``, with stiff joints."""
    sdk.ChannelFactory.Instance().Init(domain, address)
    newest: dict[str, Any] = {}

    def on_state(message: Any) -> None:
        newest["q"] = [motor.q for motor in message.motor_state_serial]
        newest["acc"], newest["rpy"] = list(message.imu_state.acc), list(message.imu_state.rpy)

    states, commands, client = sdk.B1LowStateSubscriber(on_state), sdk.B1LowCmdPublisher(), sdk.B1LocoClient()
    states.InitChannel()
    commands.InitChannel()
    client.Init()
    client.WaitForService(round(1e3 * LIMIT))
    wait(lambda: "q" in newest)
    result = {"before": int(client.GetMode().mode), "state": dict(newest)}
    command = sdk.LowCmd()
    command.cmd_type = sdk.LowCmdType.SERIAL
    motors = []
    for number, q in enumerate(newest["q"]):
        motor = sdk.MotorCmd()
        motor.q, motor.kp, motor.kd = ANGLE if number in ELBOWS else q, 60.0, 2.0
        motors.append(motor)
    command.motor_cmd = motors
    commands.Write(command)
    client.ChangeMode(sdk.RobotMode.kCustom)
    end = time.monotonic() + LIMIT
    while time.monotonic() < end and max(abs(newest["q"][elbow] - ANGLE) for elbow in ELBOWS) > 0.1:
        commands.Write(command)
        time.sleep(0.002)
    result |= {"after": int(client.GetMode().mode), "elbows": [newest["q"][elbow] for elbow in ELBOWS]}
    print(json.dumps(result))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
