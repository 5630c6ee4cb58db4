"""Dask: the workers of a cluster, or of this machine. Its scheduler has the queue and the retries.

Workers read the logs and the URDF themselves; results come back to this process, which writes them.
"""

from __future__ import annotations

import logging
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from secrets import token_hex
from typing import TYPE_CHECKING, Any

from imucalib_cli.errors import InputError
from imucalib_cli.optional import optional
from imucalib_cli.process import children_ignore_interruptions

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence

    from imucalib_cli.batch.logs import BatchLog
    from imucalib_cli.batch.task import Done, Task

_CONNECTING = "20s"
"""A scheduler that does not answer by then is not there."""
_RETRIES = 1
"""Of what fails on a worker for a reason of the worker's."""
_OWN_CLUSTER = {
    "distributed.scheduler.allowed-failures": 1,  # workers that a log may lose: one more try
    "distributed.scheduler.worker-saturation": 1.0,  # a log that waits is not lost with a worker
}
"""Configuration of a cluster of our own; others have theirs."""


@dataclass(frozen=True)
class DaskWorkers:
    """An engine: the workers of a scheduler, or a cluster of this machine."""

    scheduler: str
    """Its address, or ``local``."""
    workers: int
    memory: int
    """Bytes for each; of a local cluster, these two."""

    def __call__(self, task: Task, logs: Sequence[BatchLog]) -> Generator[tuple[BatchLog, Done]]:
        """Run the task, as the interface has it.

        Raises:
            InputError: There is no such scheduler, or Dask is not installed.
        """
        distributed = optional("distributed", "--dask needs", "dask")
        _be_quiet()
        task = replace(task, folder=Path.cwd())
        with self._client(distributed) as client:
            given = {
                # a key of its own: the same log may have been done before, by another version
                client.submit(task, log, retries=_RETRIES, key=f"imucalib-{token_hex(8)}"): log
                for log in logs
            }
            for future in distributed.as_completed(given, loop=client.loop):
                log = given.pop(future)
                error = future.exception()
                yield log, task.lost(log, _why(error)) if error else future.result()
                future.release()

    @contextmanager
    def _client(self, distributed: Any) -> Iterator[Any]:
        import dask

        with ExitStack() as stack:
            if self.scheduler == "local":
                stack.enter_context(dask.config.set(_OWN_CLUSTER))
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
                client = distributed.Client(address, timeout=_CONNECTING, set_as_default=False)
            except (OSError, ValueError, TypeError) as error:
                raise InputError(
                    f"--dask {self.scheduler}: no scheduler answers there ({error}): give an "
                    "address such as tcp://host:8786, or local"
                ) from error
            yield stack.enter_context(client)


def _be_quiet() -> None:
    """Lost workers are told in our words."""
    for name in ("distributed", "tornado"):
        logging.getLogger(name).setLevel(logging.CRITICAL)


def _why(error: BaseException) -> str:
    """Why a log was given up, in words."""
    if type(error).__name__ == "KilledWorker":
        return (
            "the workers that had it were killed, for want of memory perhaps: give them more, and "
            "run the same command again"
        )
    return (
        f"the workers cannot do it: {type(error).__name__}: {error}; install the same imucalib on "
        "all of them"
    )
