"""What each command does, without the command line: one call from paths to a result."""
