"""Simulate robots in a physics engine, add sensor noise, and write logs with their truth."""
