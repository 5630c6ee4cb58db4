"""What a log itself knows of the robot: its URDF, the names of its parts, what carries an IMU."""
