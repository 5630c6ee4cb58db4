"""A result to look at: one HTML page, and files for other tools."""
