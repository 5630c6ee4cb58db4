"""The published method, as published."""
