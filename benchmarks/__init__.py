"""One script per claim, and its table; each process computes on one core."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
