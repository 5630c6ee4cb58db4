"""Block statistics to the IMU's pose and its uncertainty; knows nothing of files."""
