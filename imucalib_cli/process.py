"""What a process is told before it computes."""

from __future__ import annotations

import os
import signal
import threading


def prepare_to_compute() -> None:
    """Set what must be set before numpy is imported; once a process, workers too."""
    # small matrices: threads cost more than they give, much more on a busy machine
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # glibc learns from the first freed large block to keep chunk-sized buffers: no page faults
    block = bytes(31 << 20)
    del block


def obey_the_parent() -> None:
    """Make this worker leave interruptions to its parent, and end when the parent does."""
    from multiprocessing import connection, parent_process  # not where only a command line starts

    parent = parent_process()

    def end_with_the_parent() -> None:
        """A worker waits for more to do for ever, also where its parent was killed."""
        if parent is not None:
            connection.wait([parent.sentinel])
            os._exit(1)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=end_with_the_parent, daemon=True).start()
