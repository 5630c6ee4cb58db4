"""Dask workers of a cluster or of this machine. The scheduler handles the queue and retries.

Workers read the logs and the URDF themselves; this process writes the results.
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
"""Time limits for the first answer of a scheduler, and for one that is busy."""
_RETRIES = 1
"""Retries of a log that fails because of its worker."""
_SOON = 0.01
"""s."""
_LOST = 1
"""Workers of our own cluster that a log may lose before it fails; other clusters have their own
limit, distributed.scheduler.allowed-failures."""


@dataclass(frozen=True)
class DaskWorkers:
    """An engine that uses the workers of a scheduler, or a cluster of this machine."""

    scheduler: str
    """Its address, or ``local``."""
    workers: int
    memory: int
    """Bytes for each; only for a local cluster, as ``workers``."""
    timeout: float | None = None
    """Time limit for a log, s."""

    def __post_init__(self) -> None:
        """Raise InputError if Dask is not installed."""
        optional("distributed", "--dask needs", "dask")

    def __call__(self, task: Task, logs: Sequence[BatchLog]) -> Generator[tuple[BatchLog, Done]]:
        """Run the task, as :class:`imucalib_cli.batch.batch.Engine`.

        Raises:
            InputError: The scheduler is not there.
        """
        distributed = optional("distributed", "--dask needs", "dask")
        for name in ("distributed", "tornado"):  # we report lost workers ourselves
            logging.getLogger(name).setLevel(logging.CRITICAL)
        task = replace(task, folder=Path.cwd())
        with self._client(distributed) as client:
            waiting = iter(logs)
            given: dict[Any, BatchLog] = {}

            def give(count: int) -> list[Any]:
                # a new key: another version may have done the same log before
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

            # a log that waits in our own worker would fail with the log that kills the worker
            at_once = self.workers if self.scheduler == "local" else len(logs)
            finished = distributed.as_completed(give(at_once), loop=client.loop)
            for future in finished:
                log = given.pop(future)
                if future.cancelled():
                    raise InputError(
                        f"--dask {self._name}: the scheduler does not answer any more: run the "
                        "same command again when it is back; what is finished is kept"
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
                        # its HTTP server: no dashboard, on a free port, so that two can run at once
                        dashboard_address="127.0.0.1:0",
                        scheduler_kwargs={"dashboard": False},
                        silence_logs=logging.CRITICAL,
                    )
                address = stack.enter_context(cluster)
            else:
                address = self.scheduler
            try:
                if address == self.scheduler:
                    asyncio.run(_check_answer(distributed, address))
                client = distributed.Client(address, timeout=_GREETING, set_as_default=False)
            except Exception as error:  # any kind; its text may hold a password
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


async def _check_answer(distributed: Any, address: str) -> None:
    """Connect once: a client that cannot connect would wait, and complain at exit."""
    security = distributed.Security().get_connection_args("client")
    comm = await distributed.comm.connect(address, timeout=_CONNECTING, **security)
    await comm.close()


class _OverTimeError(BaseException):
    """Raised in a thread whose time is up; no ``except Exception`` catches it."""


def within(seconds: float | None, task: Task, log: BatchLog) -> Done:
    """Run a task with a time limit, s, in a worker's thread, which cannot be killed.

    The limit takes effect between two steps of the interpreter, not inside a compiled library.
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
        while True:  # wait for the exception here, so that it does not come later
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
