"""Node ``camera_node``: images of the simulated robot's camera, rendered in a separate process."""

import ctypes.util
import os
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import CameraInfo, Image

from bridge.nodes.true_states import TrueStates
from bridge.plants.config import CameraConfig
from bridge.record.render import GL_ADVICE
from controllers.estimation.stamps import Due
from models.camera import Pinhole
from models.config import default_config
from models.errors import ConfigError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.parameters import declare, declare_config
from models.nodes.perception import image_message, info_message
from models.nodes.qos import EVENT, STATE
from models.nodes.spin import run
from models.terrain import FLAT, terrain_named
from models.types import Vector

if TYPE_CHECKING:
    from bridge.plants.camera import SimulatedCamera

NICENESS = 10  #: Niceness of this process, so that the robot's processes have priority


class CameraNode(PoiseNode):
    """Publishes images of the newest true state while subscribed to; without OpenGL it reports what to install."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("camera_node", **kwargs)
        self._config = declare_config(self, default_config(CameraConfig, "bridge", "camera"))
        text = "Ground of the simulated world, as in the driver: flat, tiles, box, ..."
        self._terrain = declare(self, "terrain", FLAT, text)
        self._camera: SimulatedCamera | None = None
        self._took = 0.0

    def configure(self) -> None:
        sensor = self.model.profile.sensors.camera
        if sensor is None:
            raise ConfigError(f"{self.robot}: sensors.camera: the profile has no camera")
        sensor = self._config.sensor(sensor)
        terrain_named(self._terrain)
        self._period = round(NANOSECONDS / sensor.rate)
        self._pinhole = Pinhole.of(sensor)
        self._images = self.announce(Image, topics.CAMERA_IMAGE, STATE)
        self._infos = self.announce(CameraInfo, topics.CAMERA_INFO, STATE)
        self.listen(PointStamped, topics.CAMERA_TARGET, self._on_target, EVENT)
        TrueStates(self, self._is_due, self._draw, self._on_obstacle)

    def activate(self) -> None:
        self._due = Due(self._period)
        self._missing = self._open()
        if self._missing:
            self.get_logger().warning(self._missing)

    def deactivate(self) -> None:
        camera, self._camera = self._camera, None
        if camera is not None:
            camera.close()

    def _open(self) -> str:
        """Create the camera; returns why this failed, empty on success."""
        if ctypes.util.find_library("EGL") is None:
            return GL_ADVICE
        try:
            from bridge.plants.camera import SimulatedCamera  # loads MuJoCo with OpenGL

            self._camera = SimulatedCamera(self.model, self._config, self._terrain)
        except PoiseError:
            raise
        except Exception as error:  # any error of this machine's OpenGL
            return f"{GL_ADVICE} (starting it failed: {type(error).__name__}: {error})"
        return ""

    def _on_obstacle(self, centre: Vector) -> None:
        if self._camera is not None:
            self._camera.obstacle = centre

    def _on_target(self, message: Any) -> None:
        point = np.array([message.point.x, message.point.y, message.point.z])
        if not np.isfinite(point).all():
            self.refuse(topics.CAMERA_TARGET, f"point: {point.tolist()} m is not finite")
        elif message.header.frame_id not in ("", topics.ODOM_FRAME):
            self.refuse(topics.CAMERA_TARGET, f"header.frame_id: '{message.header.frame_id[:32]}' instead of 'odom'")
        elif self._camera is not None:
            self._camera.target = point

    def _is_due(self, stamp: int) -> bool:
        return self._camera is not None and self._images.get_subscription_count() > 0 and self._due(stamp)

    def _draw(self, stamp: int, q: Vector) -> None:
        """Render and publish an image of a true state (nq,) with a stamp [ns]."""
        if self._camera is None:
            return
        begin = time.monotonic()
        picture = self._camera.render(q)
        self._infos.publish(info_message(stamp, self._pinhole))
        self._images.publish(image_message(stamp, picture))
        self._took = time.monotonic() - begin

    def before_diagnostics(self) -> None:
        if not self.active:
            return
        self.level = DiagnosticStatus.WARN if self._missing else DiagnosticStatus.OK
        listened = self._images.get_subscription_count() > 0
        self.message = self._missing or ("drawing" if listened else "no subscriber to the pictures")
        self.values["newest picture took [ms]"] = f"{1e3 * self._took:.1f}"


def main(args: list[str] | None = None) -> None:
    """Run the node in a separate process."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    os.environ.setdefault("LP_NUM_THREADS", "1")  # software rendering uses one core at most
    os.nice(NICENESS)
    sys.exit(run([CameraNode], args))


if __name__ == "__main__":
    main()
