"""Settings of processes: environment, signals, and how workers start and end."""

from __future__ import annotations

import os
import signal
import sys
import threading
import warnings
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from multiprocessing.context import BaseContext

INTERRUPTIONS: tuple[signal.Signals, ...] = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals that ask a command to end; Windows has no SIGHUP."""


def prepare_to_compute() -> None:
    """Set what must be set before numpy is imported; once a process, workers too."""
    # small matrices: threads cost more than they give, much more on a busy machine
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # after it has freed one large block glibc keeps buffers of chunks: fewer page faults
    block = bytes(31 << 20)
    del block


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute by one thread of BLAS: more cost more than they give, and sum in another order."""
    from threadpoolctl import threadpool_limits  # late: commands set it before numpy is imported

    with threadpool_limits(limits=1, user_api="blas"):
        yield


def fresh_processes(preloaded: Sequence[str] = ()) -> BaseContext:
    """How to start worker processes: not by fork, as a thread may hold a lock at that moment.

    Where the system can, the ``preloaded`` modules are imported once for all workers.
    """
    import multiprocessing  # late: most commands do not need it

    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing import forkserver  # some systems lack it

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


def limit_memory(limit: int) -> None:
    """Limit the memory of this process, bytes, where the system can."""
    with suppress(ImportError, OSError, ValueError):  # not on every system
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_DATA)
        if most != resource.RLIM_INFINITY:
            limit = min(limit, most)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, most))


def obey_the_parent() -> None:
    """Make this worker leave interruptions to its parent, and end when the parent does."""
    from multiprocessing import connection, parent_process  # late: most commands need neither

    parent = parent_process()

    def end_with_the_parent() -> None:
        """Without this a worker waits for ever for work from a parent that was killed."""
        if parent is not None:
            connection.wait([parent.sentinel])
            os._exit(1)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # the parent ends it so
    threading.Thread(target=end_with_the_parent, daemon=True).start()


@contextmanager
def children_ignore_interruptions() -> Iterator[None]:
    """Let processes that are started meanwhile ignore Ctrl-C from their first instant on.

    A terminal sends it to all of them, and one that is still importing would show a traceback.
    """
    with _handling({signal.SIGINT: signal.SIG_IGN}):  # a new program inherits only this handler
        yield


@contextmanager
def interrupted_afterwards() -> Iterator[None]:
    """Delay interruptions: a worker that is half started would show a traceback."""
    delayed: list[int] = []

    def delay(number: int, _frame: object) -> None:
        delayed.append(number)

    try:
        with _handling(dict.fromkeys(INTERRUPTIONS, delay)):
            yield
    finally:
        for number in delayed:
            signal.raise_signal(number)


@contextmanager
def _handling(handlers: dict[signal.Signals, Any]) -> Iterator[None]:
    """Set handlers of signals meanwhile; only the main thread can, in others nothing happens."""
    is_main = threading.current_thread() is threading.main_thread()
    before = {each: signal.signal(each, new) for each, new in handlers.items() if is_main}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
