"""Booster's service LocoApi and remote controller as a process, by rclpy.

    python -m tests.booster.service DOMAIN

A line on the standard input is the robot's mode and the buttons that are pressed; one on the standard output is a mode
that a client requests. It ends with its input.
"""

import json
import select
import sys

import numpy as np
from rclpy.qos import QoSProfile

from bridge.plants.booster.codec import BUTTONS, REMOTE, pack
from bridge.plants.booster.link import CHANGE_MODE, REMOTE_STATE, SERVICE
from bridge.plants.participant import SENSOR, ignore, join, take
from models.nodes.interfaces import interface

PERIOD = 0.005  #: Between two checks [s]


def main(domain: int) -> None:
    """Serve until the end of the input."""
    _, node = join(domain, "service")
    remote_type = interface("booster_interface", "msg", "RemoteControllerState")
    request_type, response_type = (interface("booster_msgs", "msg", name) for name in ("RpcReqMsg", "RpcRespMsg"))
    remotes = node.create_publisher(remote_type, REMOTE_STATE, QoSProfile(depth=1))
    requests = node.create_subscription(request_type, f"{SERVICE}Req", ignore, SENSOR)
    responses = node.create_publisher(response_type, f"{SERVICE}Resp", QoSProfile(depth=10))
    mode, record = 0, np.zeros(1, REMOTE)[0]
    while True:
        if select.select([sys.stdin], [], [], PERIOD)[0]:
            if not (line := sys.stdin.readline()):
                return
            number, *pressed = line.split()
            mode, record["buttons"] = int(number), [name in pressed for name in BUTTONS]
        remotes.publish(pack(record))
        while (request := take(requests)) is not None:
            if json.loads(request.header)["api_id"] == CHANGE_MODE:
                print(json.loads(request.body)["mode"], flush=True)
            body = json.dumps({"mode": mode})
            responses.publish(response_type(uuid=request.uuid, header=json.dumps({"status": 0}), body=body))


if __name__ == "__main__":
    main(int(sys.argv[1]))
