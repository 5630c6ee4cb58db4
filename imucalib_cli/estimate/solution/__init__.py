"""From windows to the posterior of every unknown."""
