"""imucalib: where on the robot is the IMU, from a log of it moving and a URDF."""

__version__ = "0.1.0"
