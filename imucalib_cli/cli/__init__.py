"""The command line: arguments to one call to output; errors to one line and an exit code."""
