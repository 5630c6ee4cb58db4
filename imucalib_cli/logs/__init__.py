"""Read logs: from bytes to typed streams. Knows nothing about robots."""
