"""Dask: the workers of a cluster, or of this machine. Its scheduler has the queue and the retries.

Workers read the logs and the URDF themselves; results come back to this process, which writes them.
"""

from __future__ import annotations

import asyncio
import ctypes
import logging
import threading
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from secrets import token_hex
from typing import TYPE_CHECKING, Any

from imucalib_cli.errors import InputError
from imucalib_cli.optional import optional
from imucalib_cli.process import children_ignore_interruptions
from imucalib_cli.shown import without_secrets

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence

    from imucalib_cli.batch.logs import BatchLog
    from imucalib_cli.batch.task import Done, Task

_CONNECTING, _GREETING = "5s", "20s"
"""A scheduler that does not answer by then is not there; one that does may be busy."""
_RETRIES = 1
"""Of what fails on a worker for a reason of the worker's."""
_SOON = 0.01
"""s."""
_LOST = 1
"""Workers that a log may lose before it is given up, in a cluster of our own; that of others has
its own limit, distributed.scheduler.allowed-failures."""


@dataclass(frozen=True)
class DaskWorkers:
    """An engine: the workers of a scheduler, or a cluster of this machine."""

    scheduler: str
    """Its address, or ``local``."""
    workers: int
    memory: int
    """Bytes for each; of a local cluster, these two."""
    timeout: float | None = None
    """s that a log may take; None is any time."""

    def __post_init__(self) -> None:
        """See that Dask is installed; else InputError."""
        optional("distributed", "--dask needs", "dask")

    def __call__(self, task: Task, logs: Sequence[BatchLog]) -> Generator[tuple[BatchLog, Done]]:
        """Run the task, as the interface has it; InputError where the scheduler is not there."""
        distributed = optional("distributed", "--dask needs", "dask")
        for name in ("distributed", "tornado"):  # lost workers are told in our words
            logging.getLogger(name).setLevel(logging.CRITICAL)
        task = replace(task, folder=Path.cwd())
        with self._client(distributed) as client:
            waiting = iter(logs)
            given: dict[Any, BatchLog] = {}

            def give(count: int) -> list[Any]:
                # a key of its own: the same log may have been done before, by another version
                new = {
                    client.submit(
                        within,
                        self.timeout,
                        task,
                        log,
                        retries=_RETRIES,
                        key=f"imucalib-{token_hex(8)}",
                    ): log
                    for log in islice(waiting, count)
                }
                given.update(new)
                return list(new)

            # a log that waits for a worker of our own would be blamed with the one that kills it
            at_once = self.workers if self.scheduler == "local" else len(logs)
            finished = distributed.as_completed(give(at_once), loop=client.loop)
            for future in finished:
                log = given.pop(future)
                if future.cancelled():
                    raise InputError(
                        f"--dask {self._name}: the scheduler went away: run the same command "
                        "again when it is back; what is finished is kept"
                    )
                error = future.exception()
                done = task.lost(log, _why(error)) if error else future.result()
                future.release()
                finished.update(give(1))
                yield log, done

    @contextmanager
    def _client(self, distributed: Any) -> Iterator[Any]:
        import dask

        with ExitStack() as stack:
            if self.scheduler == "local":
                stack.enter_context(
                    dask.config.set({"distributed.scheduler.allowed-failures": _LOST})
                )
                with children_ignore_interruptions():
                    cluster = distributed.LocalCluster(
                        n_workers=self.workers,
                        threads_per_worker=1,
                        memory_limit=self.memory,
                        dashboard_address=None,
                        silence_logs=logging.CRITICAL,
                    )
                address = stack.enter_context(cluster)
            else:
                address = self.scheduler
            try:
                if address == self.scheduler:
                    asyncio.run(_see_answer(distributed, address))
                client = distributed.Client(address, timeout=_GREETING, set_as_default=False)
            except Exception as error:  # of whatever kind; its words may hold a password
                raise InputError(
                    f"--dask {self._name}: no scheduler answers there: give an address such as "
                    "tcp://host:8786, with the certificates that Dask is configured to use, or "
                    "local"
                ) from error
            yield stack.enter_context(client)

    @property
    def _name(self) -> str:
        """The scheduler for messages."""
        has_protocol = "://" in self.scheduler or self.scheduler == "local"
        return without_secrets(self.scheduler if has_protocol else f"tcp://{self.scheduler}")


async def _see_answer(distributed: Any, address: str) -> None:
    """Connect once: a client that fails to, and is left, waits and complains when all ends."""
    security = distributed.Security().get_connection_args("client")
    comm = await distributed.comm.connect(address, timeout=_CONNECTING, **security)
    await comm.close()


class _OverTimeError(BaseException):
    """Raised in a thread whose time is up; nothing on its way takes it for an error of its own."""


def within(seconds: float | None, task: Task, log: BatchLog) -> Done:
    """Do a task in the thread of a worker, which cannot be killed as a process can, within s.

    Between two steps of the interpreter the time is seen to be up, so not within a call of a
    compiled library.
    """
    if seconds is None:
        return task(log)
    thread = ctypes.c_ulong(threading.get_ident())
    raise_in, ended = ctypes.pythonapi.PyThreadState_SetAsyncExc, threading.Lock()

    def end() -> None:
        if ended.acquire(blocking=False):
            raise_in(thread, ctypes.py_object(_OverTimeError))

    timer = threading.Timer(seconds, end)
    timer.daemon = True
    timer.start()
    try:
        done = task(log)
        if ended.acquire(blocking=False):
            return done
        while True:  # it is on its way, and must not come later
            time.sleep(_SOON)
    except _OverTimeError:
        return task.late(log, seconds)
    finally:
        timer.cancel()


def _why(error: BaseException) -> str:
    if type(error).__name__ == "KilledWorker":
        return (
            "the workers that had it were killed, for want of memory perhaps: give them more, and "
            "run the same command again"
        )
    return (
        f"the workers cannot do it: {type(error).__name__}: {error}; install the same imucalib on "
        "all of them"
    )
