"""Physical constants and units, order of the feet, and first joint index of q and v."""

GRAVITY = 9.81  #: Gravitational acceleration [m/s^2], as in Pinocchio's models; also set in the plant
NANOSECONDS = 1_000_000_000  #: Nanoseconds in one second
COM_HEIGHT_MIN = 0.1  #: Minimum CoM height of the pendulum model; keeps its frequency finite [m]
FOOT_NAMES = ("left", "right")  #: Order of the feet in every array with one row per foot
JOINTS_Q, JOINTS_V = 7, 6  #: Index of the first joint in q and in v, after the base coordinates
