"""Several logs of a mount, or several IMUs of a log, solved together from their statistics."""
