"""The simulated camera: off-screen rendering with MuJoCo, in a process that sets ``MUJOCO_GL`` before the import."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from bridge.plants.config import CameraConfig
from bridge.plants.world import SeenWorld
from models.camera import Pinhole
from models.config import default_config
from models.errors import ConfigError
from models.profile import CAMERA_FRAME
from models.robot_model import RobotModel
from models.terrain import FLAT, Terrain
from models.types import Matrix, Vector

_HIDDEN = 5  #: Group of geoms that are not drawn


class SimulatedCamera(SeenWorld):
    """Renders the world of a simulated robot from frame ``camera_optical_frame``.

    It renders a copy of the plant's world at given states, so the plant does not wait for images. The link that carries
    the camera is invisible to it, as from inside a housing.

    ``target`` is the position of the ball in W (3,) [m], None for no ball. Raises ``ConfigError`` when the robot has no
    camera, and the errors of MuJoCo without a usable OpenGL.
    """

    def __init__(self, model: RobotModel, config: CameraConfig | None = None, terrain: str | Terrain = FLAT) -> None:
        self._config = config = config or default_config(CameraConfig, "bridge", "camera")
        if model.profile.sensors.camera is None:
            raise ConfigError(f"{model.name}: sensors.camera: the profile has no camera")
        self.intrinsics = pinhole = Pinhole.of(config.sensor(model.profile.sensors.camera))
        self.target: Vector | None = None
        super().__init__(model, terrain)
        world = self._model
        world.vis.global_.offwidth, world.vis.global_.offheight = pinhole.width, pinhole.height
        self._site = int(world.site(CAMERA_FRAME).id)
        own = world.body_weldid[world.site_bodyid[self._site]]
        self._groups: NDArray[np.int32] = world.geom_group.copy()
        self._groups[world.body_weldid[world.geom_bodyid] == own] = _HIDDEN
        self._view = mujoco.MjvCamera()
        self._renderer = mujoco.Renderer(world, pinhole.height, pinhole.width)
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = config.shadows
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()

    def render(self, q: Vector) -> NDArray[np.uint8]:
        """RGB image (height, width, 3) of the robot at a configuration (nq,)."""
        position, axes = self.place(q)
        mujoco.mj_comPos(self._model, self._data)  # lights follow the robot's centre of mass
        mujoco.mj_camlight(self._model, self._data)
        self._model.geom_group[:] = np.where(self._in_sight(position, axes), self._groups, _HIDDEN)
        self._renderer.update_scene(self._data, self._view)
        self._add_target()
        self._aim(position, axes)
        picture: NDArray[np.uint8] = self._renderer.render()
        return picture

    def place(self, q: Vector) -> tuple[Vector, Matrix]:
        """Set a configuration (nq,); returns the pose of the camera in W: position (3,) [m], axes (3, 3)."""
        self.set(q)
        return self._data.site_xpos[self._site].copy(), self._data.site_xmat[self._site].reshape(3, 3).copy()

    def _in_sight(self, position: Vector, axes: Matrix) -> NDArray[np.bool_]:
        """Whether each geom may be in the image (ngeom,), because meshes out of sight take rendering time, too."""
        x, y, z = ((self._data.geom_xpos - position) @ axes).T
        reach, pinhole = self._model.geom_rbound, self.intrinsics
        seen: NDArray[np.bool_] = z > -reach
        halves = 0.5 * pinhole.width, 0.5 * pinhole.height
        for across, half, focal in zip((x, y), halves, pinhole.focal, strict=True):
            seen &= (focal * np.abs(across) - half * z) <= reach * np.hypot(focal, half)
        seen |= reach == 0.0  # a plane has no bounding sphere
        return seen

    def _add_target(self) -> None:
        scene, target = self._renderer.scene, self._config.target
        if self.target is None or scene.ngeom >= scene.maxgeom:
            return
        size, place, axes = np.full(3, target.radius), np.asarray(self.target, dtype=float), np.eye(3).ravel()
        colour = np.array([*target.colour, 1.0], dtype=np.float32)
        mujoco.mjv_initGeom(scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_SPHERE, size, place, axes, colour)
        scene.ngeom += 1

    def _aim(self, position: Vector, axes: Matrix) -> None:
        near, pinhole = self._config.near, self.intrinsics
        half = near * 0.5 * pinhole.height / pinhole.focal[1]
        for eye in self._renderer.scene.camera:
            eye.pos[:], eye.forward[:], eye.up[:] = position, axes[:, 2], -axes[:, 1]
            eye.frustum_center, eye.frustum_width = 0.0, near * 0.5 * pinhole.width / pinhole.focal[0]
            eye.frustum_bottom, eye.frustum_top = -half, half
            eye.frustum_near, eye.frustum_far = near, self._config.far
