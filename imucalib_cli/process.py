"""What a process is told before it computes."""

from __future__ import annotations

import os


def prepare_to_compute() -> None:
    """Set what must be set before numpy is imported; once a process, workers too."""
    # small matrices: threads cost more than they give, much more on a busy machine
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # glibc learns from the first freed large block to keep chunk-sized buffers: no page faults
    block = bytes(31 << 20)
    del block
