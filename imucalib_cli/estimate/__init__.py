"""From samples and a path to the pose and its covariance."""
