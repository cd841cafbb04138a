"""The simulated robot with its motor drivers, held at the start until its feet carry it; no ROS."""

from __future__ import annotations

from bridge.loop_config import LoopConfig
from bridge.mujoco_plant import MujocoPlant
from bridge.start_up import ReleaseGate, hanging_command
from controllers.driver_orders import follow_mode
from controllers.joint_servo import JointServo, ServoState
from controllers.sample_assembler import mean_sample
from controllers.supervisor import ACTIVE_MODES
from models.calibration import correct_encoders
from models.errors import CommandError
from models.types import JointCommand, JointTrajectory, Mode, SensorData, Vector

HELD, HANGING = "held", "hanging"
"""Driver states of a robot that the simulator holds, on the floor or in the air; the others are of ``ServoState``."""


class DrivenRobot:
    """Plant and joint servo in step, with the hold at the start.

    Held, the drivers carry the joints against gravity. When the mode lets the robot move and commands arrive, they
    execute those; when both feet carry the weight, the weld lets go. Should the commands cease before that, the drivers
    carry the joints again and the next command begins anew. Hanging, nothing moves it until it is let down.

    Args:
        plant: Simulated robot.
        config: Times and tolerances of the start.
        servo: Driver law; that with the packaged configuration when None.

    Attributes:
        encoder_offsets: What the drivers subtract from their encoders (nj,) [rad]; None for nothing. To be changed
            just before ``reset`` only: joints that are suddenly read otherwise are pulled there.
        interruptions: Times that the commands ceased while the robot was held.
    """

    def __init__(self, plant: MujocoPlant, config: LoopConfig, servo: JointServo | None = None) -> None:
        self.plant = plant
        self.servo = servo or JointServo(plant.robot)
        self._config = config
        self._at_rest = hanging_command(plant.robot)
        self._mode = Mode.OFF
        self.encoder_offsets: Vector | None = None
        self.interruptions = 0
        self.reset()

    def reset(self, *, hanging: bool = False) -> None:
        """Back to the start: standing posture, held on the floor or hanging above it, no mode."""
        self.plant.reset()
        self._hanging = hanging
        if hanging:
            self.plant.hoist(self._config.hoist_height)
        self.servo.arm()
        self._mode = Mode.OFF
        self._commanded = False
        self._gate: ReleaseGate | None = None

    @property
    def state(self) -> str:
        """``held``, ``hanging``, or what the drivers do: ``active``, ``damped`` or ``off``."""
        if not self.plant.held:
            return self.servo.state.value
        return HANGING if self._hanging else HELD

    @property
    def movable(self) -> bool:
        """Whether the crane may take the robot: held with no mode, hanging, or off."""
        return self._mode is Mode.OFF and (self.plant.held or self.servo.state is ServoState.OFF)

    def read(self) -> SensorData:
        """This tick's sensors, the encoders corrected by the drivers."""
        raw = self.plant.read()
        return raw if self.encoder_offsets is None else correct_encoders(raw, self.encoder_offsets)

    @property
    def awaits_command(self) -> bool:
        """Whether the drivers would execute a command of the controller."""
        return self._mode in ACTIVE_MODES and self.servo.state is ServoState.ACTIVE

    def set_mode(self, mode: Mode) -> None:
        """Follow the supervisor: arm, damp or switch off the drivers. A held robot stays held and carried.

        Raises:
            CommandError: Off, while the drivers are active: the robot would drop. A mode to move in, while it hangs.
        """
        if self._hanging and mode in ACTIVE_MODES:
            raise CommandError(f"mode '{mode.value}' refused: the robot hangs in the air")
        if not self.plant.held:
            follow_mode(self.servo, self._mode, mode)
        self._mode = mode
        if mode in ACTIVE_MODES:
            return
        self._commanded, self._gate = False, None
        if self.plant.held:
            self.servo.blend()

    def command(self, command: JointCommand | JointTrajectory) -> bool:
        """Give the drivers a set-point or a trajectory, if the mode lets the robot move.

        Returns:
            Whether it is in force.

        Raises:
            JointNameError: A joint of a trajectory is unknown or named twice.
            TrajectoryError: The trajectory is refused.
        """
        if not self.awaits_command:
            return False
        if self.plant.held and not self._commanded:
            self.servo.blend()
        if isinstance(command, JointTrajectory):
            taken = self.servo.command_trajectory(command, self.plant.t)
        else:
            taken = self.servo.command(command, self.plant.t)
        if taken and self.plant.held and self._gate is None:
            self._gate = ReleaseGate(self.plant.robot, self._config)
        self._commanded |= taken
        return taken

    def settle(self) -> SensorData:
        """Let the held robot settle for ``hang_time``.

        Returns:
            Its sensors averaged over the last ``average_time``.
        """
        dt = self.plant.period
        count, last = round(self._config.hang_time / dt), round(self._config.average_time / dt)
        samples = []
        for i in range(count):
            self.step()
            if i >= count - last:
                samples.append(self.read())
        return mean_sample(samples)

    def step(self) -> None:
        """One period: drivers, physics, and the hold."""
        self.before_physics()
        self.plant.step()
        self.after_physics()

    def before_physics(self) -> None:
        """First part of a period: the drivers."""
        plant, servo = self.plant, self.servo
        sensors, dt = self.read(), plant.period
        if plant.held and self._commanded and servo.overdue(plant.t):
            self._begin_anew()
        if plant.held and not self._commanded:
            servo.command(self._at_rest, plant.t)
        plant.write(servo.step(plant.t, sensors.q, sensors.v, dt))

    def after_physics(self) -> None:
        """Last part, once the world has moved: the hold."""
        if self._gate is not None and self._gate.update(self.plant.load, self.plant.period):
            self.plant.hold(False)
            self._gate = None

    def _begin_anew(self) -> None:
        """Carry the held joints again: nothing has happened to the robot, and nobody would arm damped drivers."""
        self.interruptions += 1
        self._commanded, self._gate = False, None
        self.servo.blend()
