"""Many logs with the same options: each on its own, none stopping the others, resumable."""
