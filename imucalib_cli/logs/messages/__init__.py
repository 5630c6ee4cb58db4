"""Types of messages, from bytes to numbers."""
