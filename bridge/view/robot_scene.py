"""The robot's visual meshes in a viser scene, moved by its configuration."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import trimesh

from models.robot_model import RobotModel
from models.types import Vector
from models.urdf import data_folder

WORLD = "/world"  #: Scene frame of ``odom``; it moves under a robot that the camera follows


class RobotScene:
    """One scene frame for each joint in a viser scene, with the meshes of its bodies.

    Attributes:
        frames: Scene frame of each joint, by Pinocchio's index; the base is joint 1.
        missing: Meshes that could not be read, which are left out.
    """

    def __init__(self, scene: Any, model: RobotModel) -> None:
        self._model, self._data = model, model.data()
        self.missing: list[str] = []
        self.frames = {
            joint: scene.add_frame(f"{WORLD}/robot/{model.pin.names[joint]}", show_axes=False)
            for joint in range(1, model.pin.njoints)
        }
        for shape in _visuals(model):
            if shape.parentJoint not in self.frames:
                continue
            mesh = _mesh_of(shape)
            if mesh is None:
                self.missing.append(shape.name)
                continue
            color = tuple(int(255 * channel) for channel in shape.meshColor[:3])
            scene.add_mesh_simple(
                f"{WORLD}/robot/{model.pin.names[shape.parentJoint]}/{shape.name}",
                np.asarray(mesh.vertices, dtype=np.float32) * np.asarray(shape.meshScale, dtype=np.float32),
                np.asarray(mesh.faces, dtype=np.uint32),
                color=color,
                flat_shading=True,
                wxyz=_wxyz(shape.placement.rotation),
                position=shape.placement.translation,
            )

    def show(self, q: Vector) -> None:
        """Move the robot to a configuration (nq,)."""
        pin.forwardKinematics(self._model.pin, self._data, q)
        for joint, frame in self.frames.items():
            placement = self._data.oMi[joint]
            frame.position, frame.wxyz = placement.translation.copy(), _wxyz(placement.rotation)


def _visuals(model: RobotModel) -> list[Any]:
    """Visual shapes of the URDF on the joints of the model."""
    folders = [data_folder().parent, model.urdf.parent, *model.urdf.parent.parents[:2]]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # Pinocchio's, about folders given twice
        return list(
            pin.buildGeomFromUrdf(
                model.pin, str(model.urdf), pin.GeometryType.VISUAL, [str(path) for path in folders]
            ).geometryObjects
        )


def _mesh_of(shape: Any) -> Any:
    """Unscaled triangles of a visual shape (trimesh); None where they cannot be read."""
    if Path(shape.meshPath).is_file():
        try:
            return trimesh.load(shape.meshPath, force="mesh")
        except Exception:  # trimesh raises many kinds, also for decoders that are not installed
            return None
    geometry = shape.geometry
    if isinstance(geometry, coal.Box):
        return trimesh.creation.box(extents=2.0 * geometry.halfSide)
    if isinstance(geometry, coal.Sphere):
        return trimesh.creation.icosphere(subdivisions=2, radius=geometry.radius)
    if isinstance(geometry, coal.Cylinder):
        return trimesh.creation.cylinder(radius=geometry.radius, height=2.0 * geometry.halfLength, sections=24)
    if isinstance(geometry, coal.Capsule):
        return trimesh.creation.capsule(radius=geometry.radius, height=2.0 * geometry.halfLength, count=(16, 16))
    return None


def _wxyz(rotation: Any) -> Vector:
    """Quaternion w, x, y, z of a rotation matrix, in viser's order."""
    return np.roll(pin.Quaternion(rotation).coeffs(), 1)
