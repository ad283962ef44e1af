r"""The rate and the range of the actions of the simulated gripper."""

CONTROL_RATE = 20  # Hz
MIN_SQUEEZE, MAX_SQUEEZE = 0.3, 30.0  # N
MAX_LOG_CHANGE = 0.3  # largest change of the logarithm of the squeeze per step
MAX_LIFT_SPEED = 0.05  # m/s
