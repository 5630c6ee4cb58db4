"""Whether an IMU's data can be used, and its repair."""
