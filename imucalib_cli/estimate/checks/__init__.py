"""What is wrong with a fit, and what the motion does not determine."""
