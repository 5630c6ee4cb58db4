"""Robots moved by a physics engine, IMU noise, and logs of it with their truth."""
