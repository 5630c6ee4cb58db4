"""Bytes to typed streams; knows nothing of robots."""
