"""Two poses with their covariances, and what is said of them."""
