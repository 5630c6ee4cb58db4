"""For all tests, before numpy is imported."""

import os

# As the command line does: two threads for small matrices cost fifty times more than they give.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
