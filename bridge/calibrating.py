"""Calibrations in the closed loop: motions, samples and result."""

from collections.abc import Callable

from bridge.loop.lockstep import Lockstep
from controllers.calibration.session import CalibrationSession
from models.calibration import Calibration
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import CommandReply, Mode
from planners.library import calibration_motions, variant
from planners.motion import MotionPlanner


class Calibrator:
    """Runs ``CalibrationSession`` in lockstep.

    ====== ============================================== =========================================================
    what   standing                                       hanging (``start="hang"``)
    ====== ============================================== =========================================================
    imu    stands still                                   hangs still
    joints moves the base over both soles: the joints     each jig posture of the profile: all joints
           between the soles and the IMU
    feet   shifts its load from foot to foot: gains       hangs still: offsets
    ====== ============================================== =========================================================
    """

    def __init__(self, robot: RobotModel, lockstep: Lockstep) -> None:
        self._robot, self._lockstep = robot, lockstep
        self._session = CalibrationSession(robot)
        self._planner: MotionPlanner | None = None

    def run(self, what: str) -> CommandReply:
        """Calibrate 'imu', 'joints' or 'feet' for the next start; the reply has the results or a refusal."""
        lockstep = self._lockstep
        ready = lockstep.hanging or lockstep.stack.mode is Mode.STAND
        if not ready:
            mode = lockstep.stack.mode.value
            return CommandReply(
                False, f"calibration of '{what[:32]}' refused in mode '{mode}': the robot must stand or hang"
            )
        reply = self._session.start(what, standing=not lockstep.hanging)
        if not reply.accepted:
            return reply
        self._wait(self._session.config.settle)
        lockstep.listener = self._session.add
        try:
            problem = self._procedure(what)()
        finally:
            lockstep.listener = None
        if problem:
            self._session.cancel()
            return CommandReply(False, problem)
        base = lockstep.stack.calibration or Calibration.none(self._robot)
        outcome = self._session.finish(base)
        if outcome.calibration is not None:
            lockstep.stack.calibration = outcome.calibration
        return outcome.reply

    def _procedure(self, what: str) -> Callable[[], str]:
        hanging, config = self._lockstep.hanging, self._session.config
        if what == "imu":
            return lambda: self._wait(config.imu.time)
        if what == "feet":
            return lambda: self._wait(config.feet.time) if hanging else self._move("calibrate_feet")
        return self._jig if hanging else lambda: self._move("calibrate_joints")

    def _wait(self, time: float) -> str:
        """Run for a time [s]; returns the reason of a failure, otherwise empty."""
        lockstep = self._lockstep
        for _ in range(round(time / lockstep.plant.period)):
            lockstep.step()
        if lockstep.hanging or lockstep.stack.mode is Mode.STAND:
            return ""
        return f"calibration aborted: {'; '.join(lockstep.stack.supervisor.faults) or lockstep.stack.mode.value}"

    def _jig(self) -> str:
        lockstep, config = self._lockstep, self._session.config
        for posture in self._robot.profile.jig_postures:
            lockstep.plant.clamp(self._robot.posture(posture))
            lockstep.listener = None
            self._wait(config.settle)
            lockstep.listener = self._session.add
            self._wait(config.posture.time)
        self._lockstep.plant.clamp(None)
        return ""

    def _move(self, motion: str) -> str:
        """Run a motion to its end; returns the reason of a failure, otherwise empty."""
        self._planner = self._planner or MotionPlanner(self._robot, extra=calibration_motions())
        motion = variant(motion, self._robot.name, self._planner.names)
        try:
            trajectory = self._planner.plan(motion, start_q=self._lockstep.stack.posture[0])
            self._lockstep.stack.follow(trajectory)
        except PoiseError as error:
            return f"calibration refused: {error}"
        return self._wait(float(trajectory.times[-1]) + self._session.config.window)
