r"""Rate and range of the actions of the simulated gripper."""

CONTROL_RATE = 20  # Hz
MIN_SQUEEZE, MAX_SQUEEZE = 0.3, 30.0  # N
MAX_LOG_CHANGE = 0.3  # of the squeeze in a step
MAX_LIFT_SPEED = 0.05  # m/s
