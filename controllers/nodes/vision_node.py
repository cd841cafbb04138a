"""Node ``vision_node``: images in, bearing of a target out; optionally the head follows it."""

import math
import time
from typing import Any

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Bool

from controllers.vision.gaze import AngleHistory, Gaze
from controllers.vision.target_finder import TargetConfig, TargetFinder
from models.camera import Pinhole, azimuth_elevation
from models.config import default_config
from models.errors import MessageError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import head_from_message, head_message, stamp_ns
from models.nodes.parameters import declare, declare_config, declare_ns
from models.nodes.perception import picture_of, pinhole_of
from models.nodes.qos import EVENT, SENSOR, STATE
from models.nodes.spin import program
from models.types import Vector

SILENCE = 1.0  #: Time without a picture after which the diagnostics say so [s]
ANGLES = ("azimuth [deg]", "elevation [deg]")  #: Items of the diagnostics while a target is in the picture


class VisionNode(PoiseNode):
    """Runs ``TargetFinder`` on each image; with ``follow`` it turns the head by ``Gaze``."""

    AUTOSTART = True

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("vision_node", **kwargs)
        config = default_config(TargetConfig, "controllers", "vision")
        self._config = declare_config(self, config, "target.")
        text = "Whether to turn the head towards the target, by head/pan_tilt; the robot must have a head"
        self._follow = declare(self, "follow", False, text)
        text = "Largest time between a picture and the head angle assigned to it [s]"
        self._tolerance = declare_ns(self, "head_tolerance", 0.1, text, low=0.0)

    def configure(self) -> None:
        self._finder = TargetFinder(self._config)
        self._gaze = Gaze(self.model) if self._follow else None
        self._angles = AngleHistory()
        self._camera: Pinhole | None = None
        self._newest = -math.inf  # arrival of the newest picture on the monotonic clock [s]
        self._bearings = self.announce(Vector3Stamped, topics.VISION_BEARING, STATE)
        self._detected = self.announce(Bool, topics.VISION_DETECTED, STATE)
        self.listen(CameraInfo, topics.CAMERA_INFO, self._on_info, SENSOR)
        self.listen(Image, topics.CAMERA_IMAGE, self._on_image, SENSOR, while_active=True)
        if self._gaze is not None:
            self._head = self.announce(JointState, topics.HEAD_COMMAND, EVENT)
            self.listen(JointState, topics.HEAD_STATE, self._on_head, SENSOR)

    def _on_info(self, message: Any) -> None:
        self._camera = pinhole_of(message)

    def _on_head(self, message: Any) -> None:
        self._angles.add(stamp_ns(message.header.stamp), *head_from_message(message))

    def _on_image(self, message: Any) -> None:
        picture, camera = picture_of(message), self._camera
        if camera is None:
            raise MessageError(f"no message on {topics.CAMERA_INFO} yet")
        if picture.shape[:2] != (camera.height, camera.width):
            raise MessageError(
                f"height, width: {picture.shape[:2]}, but {(camera.height, camera.width)} in the camera info"
            )
        self._newest, seen = time.monotonic(), self._finder.find(picture)
        self._detected.publish(Bool(data=seen is not None))
        self._publish_bearing(message, None if seen is None else camera.bearing(seen.pixel))

    def _publish_bearing(self, image: Any, bearing: Vector | None) -> None:
        """Publish a bearing (3,), and turn the head there."""
        if bearing is None:
            self._report("no target in the picture")
            return
        self._report("target in the picture", *np.degrees(azimuth_elevation(bearing)).tolist())
        message = Vector3Stamped(header=image.header)
        message.vector.x, message.vector.y, message.vector.z = bearing.tolist()
        self._bearings.publish(message)
        if self._gaze is None:
            return
        stamp = stamp_ns(image.header.stamp)
        angles = self._angles.at(stamp, self._tolerance)
        if angles is None:
            when = stamp / NANOSECONDS
            self.refuse(topics.HEAD_STATE, f"no head angle at {when:.3f} s, the time of a picture")
            return
        self._head.publish(head_message(stamp, *self._gaze.aim(float(angles[0]), float(angles[1]), bearing)))

    def _report(self, text: str, *angles: float) -> None:
        """Set the diagnostics, with azimuth and elevation of a target [deg]."""
        self.message = text
        for name in ANGLES:
            self.values.pop(name, None)
        self.values |= {name: f"{angle:.2f}" for name, angle in zip(ANGLES, angles, strict=False)}

    def before_diagnostics(self) -> None:
        if self.active and time.monotonic() - self._newest > SILENCE:
            self._report("no picture")


main = program(VisionNode)


if __name__ == "__main__":
    main()
