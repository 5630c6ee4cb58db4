"""Processes that run cases one after another and may be lost to one of them."""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import os
import shutil
import tempfile
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from tools.fuzz import cases
from tools.fuzz.check import check, prepare

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from multiprocessing.connection import Connection
    from multiprocessing.process import BaseProcess

_PATIENCE = 90.0
"""s without a word from a worker after which it counts as hanging, whatever else is running."""
_RENEWED = 400
"""Cases after which a worker is replaced, so that none profits from what another left."""


@dataclass(frozen=True)
class Job:
    """What all cases share."""

    seed: int
    kinds: tuple[str, ...]
    runs: float


@dataclass(frozen=True)
class Done:
    """What came of a case."""

    number: int
    what: str
    code: int | None
    findings: list[str] = field(default_factory=list)


def run(job: Job, numbers: Sequence[int], workers: int = 1) -> Iterator[Done]:
    """Run cases in forked processes; in the order they end."""
    cases.warm()
    fork = multiprocessing.get_context("fork")
    left = list(numbers)
    active: dict[Connection, tuple[BaseProcess, list[int]]] = {}
    while left or active:
        while left and len(active) < workers:
            size = min(_RENEWED, -(-len(left) // workers))
            mine, left = left[:size], left[size:]
            here, there = fork.Pipe(duplex=False)
            process = fork.Process(target=_work, args=(job, mine, there), daemon=True)
            process.start()
            there.close()
            active[here] = (process, mine)
        ready = multiprocessing.connection.wait(list(active), timeout=_PATIENCE)
        for channel in ready or list(active):
            assert isinstance(channel, multiprocessing.connection.Connection)
            worker, mine = active[channel]
            with suppress(EOFError):  # which says that it has ended
                if ready:
                    done = channel.recv()
                    mine.remove(done.number)
                    yield done
                    continue
            worker.join(timeout=5.0 if ready else 0.0)
            why = "hangs" if worker.is_alive() else f"died with {worker.exitcode}"
            worker.kill()
            worker.join()
            del active[channel]
            if mine and worker.exitcode != 0:
                yield Done(mine.pop(0), "", None, [f"LOST worker: {why}"])
            left = [*mine, *left]


def _work(job: Job, numbers: list[int], channel: Connection) -> None:
    """Make, run and clear away cases one after another."""
    prepare()
    for number in numbers:
        folder = Path(tempfile.mkdtemp(prefix="imucalib-fuzz-"))
        try:
            case = cases.make(job.seed, number, job.kinds, folder, runs=job.runs)
            code, findings = check(case)
            channel.send(Done(number, case.what, code, findings))
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    channel.close()
    os._exit(0)
