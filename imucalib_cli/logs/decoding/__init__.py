"""Messages to streams: in bulk, and one by one where that fails."""
