"""What a process is told before it computes."""

from __future__ import annotations

import os
import signal
import sys
import threading
import warnings
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from multiprocessing.context import BaseContext


def prepare_to_compute() -> None:
    """Set what must be set before numpy is imported; once a process, workers too."""
    # small matrices: threads cost more than they give, much more on a busy machine
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # glibc learns from the first freed large block to keep chunk-sized buffers: no page faults
    block = bytes(31 << 20)
    del block


def fresh_processes(preloaded: Sequence[str] = ()) -> BaseContext:
    """How worker processes are started: not by fork, as a thread may hold a lock at that moment.

    Where the system can, the modules that workers need are imported once for all.
    """
    import multiprocessing  # not where only a command line starts

    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing import forkserver  # not on every system

    context = multiprocessing.get_context("forkserver")
    if preloaded:
        context.set_forkserver_preload(list(preloaded))
    with children_ignore_interruptions():
        forkserver.ensure_running()
    return context


def prepare_worker() -> None:
    """Set what a worker process needs before its first work."""
    prepare_to_compute()
    if not sys.warnoptions:
        warnings.simplefilter("ignore")  # as in the command line itself
    obey_the_parent()


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
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # by which the parent ends it
    threading.Thread(target=end_with_the_parent, daemon=True).start()


@contextmanager
def children_ignore_interruptions() -> Iterator[None]:
    """Let processes that are started meanwhile ignore Ctrl-C from their first instant on.

    A terminal sends it to all of them, and one that is still importing would show a traceback.
    """
    if threading.current_thread() is not threading.main_thread():  # others may set no handlers
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # which alone a new program inherits
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def interrupted_afterwards() -> Iterator[None]:
    """Put off what interrupts this process: one that is half started would show a traceback."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    put_off: list[int] = []
    before = {
        number: signal.signal(number, lambda *got: put_off.append(got[0]))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for each in put_off:
            signal.raise_signal(each)
