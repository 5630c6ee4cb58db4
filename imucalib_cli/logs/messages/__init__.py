"""Types of messages, and which of their numbers are used."""
