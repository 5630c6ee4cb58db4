"""Names of the columns of the lean linear system from which the rotation is found without a guess.

A window's residual is J x, with x = (1, t, vec R, b_a', b_g', g): an exact sensor with constant
biases, an exact robot, a known time offset.
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
COUNT: Final = 22
