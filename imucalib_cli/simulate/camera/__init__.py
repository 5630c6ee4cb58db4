"""A camera on a simulated robot: what it sees, its images, and what Kalibr is told of it."""
