"""A camera on a simulated robot: its view, its images, and the files for Kalibr."""
