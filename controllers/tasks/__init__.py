"""Tasks of the whole-body QP, one per file."""

from controllers.tasks.angular_momentum import AngularMomentumTask
from controllers.tasks.base import Task
from controllers.tasks.com import CoMTask
from controllers.tasks.foot import FootTask
from controllers.tasks.orientation import OrientationTask
from controllers.tasks.posture import PostureTask

__all__ = ["AngularMomentumTask", "CoMTask", "FootTask", "OrientationTask", "PostureTask", "Task"]
