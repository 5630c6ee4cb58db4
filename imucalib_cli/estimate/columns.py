"""Names of the columns in which every residual of the estimator is linear.

A window's residual is J x, with x = (1, t, vec R, b_a', b_g', g, tau) and, where the data ask for
them, changes of the sensor's own constants (drift, delay, scales, misalignment).
"""

from __future__ import annotations

from typing import Final

ONE: Final = 0
"""The known part: the derivative of the parent frame's own motion."""
T: Final = slice(1, 4)
"""t_parent_imu, m."""
R: Final = slice(4, 13)
"""R_parent_imu, row by row."""
BA: Final = slice(13, 16)
"""Accelerometer bias seen in the parent frame, R_parent_imu b_a, m/s²."""
BG: Final = slice(16, 19)
"""Gyroscope bias seen in the parent frame, R_parent_imu b_g, rad/s."""
G: Final = slice(19, 22)
"""gravity_world, m/s²."""
TAU: Final = 22
"""Change of the time offset, s."""
DRIFT: Final = 23
"""Change of the IMU clock's drift against the robot's, s/s."""
DELAY: Final = 24
"""Change of the gyroscope's delay behind the accelerometer, s."""
SA: Final = slice(25, 28)
"""Relative change of the accelerometer's scale, IMU axes."""
SG: Final = slice(28, 31)
"""Relative change of the gyroscope's scale, IMU axes."""
MG: Final = slice(31, 34)
"""Turn of the gyroscope's axes against the accelerometer's, IMU axes, rad."""
EXTRAS: Final = slice(23, 34)
"""Drift, delay, scales and misalignment: looked for only where the data ask for them."""
COUNT: Final = 34
