"""The commands without the command line: each is one call from paths to a result."""
