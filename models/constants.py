"""Physical constants and units, the order of the feet, and where the joints begin."""

GRAVITY = 9.81  #: Magnitude of free fall [m/s^2]: that of Pinocchio's models, and so of the plant
NANOSECONDS = 1_000_000_000  #: In a second
COM_HEIGHT_MIN = 0.1  #: Least CoM height of the pendulum model, so that its frequency stays finite [m]
FOOT_NAMES = ("left", "right")  #: Order of the feet in every array with one row per foot
JOINTS_Q, JOINTS_V = 7, 6  #: Index of the first joint in a configuration and in a velocity, after those of the base
