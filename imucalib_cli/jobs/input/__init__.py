"""What a command is given: options, streams, motion, readings."""
