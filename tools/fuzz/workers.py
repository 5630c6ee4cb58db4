"""Processes that run cases one after another and may be lost to one of them."""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import os
import shutil
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from tools.fuzz import cases
from tools.fuzz.check import check, prepare

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from multiprocessing.connection import Connection

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
    left = [list(numbers)[k::workers] for k in range(workers)]
    active: dict[Connection, tuple[int, multiprocessing.process.BaseProcess]] = {}
    for k in range(workers):
        if left[k]:
            _start(job, left[k], k, active)
    while active:
        ready = multiprocessing.connection.wait(list(active), timeout=_PATIENCE)
        for channel in ready or list(active):
            assert isinstance(channel, multiprocessing.connection.Connection)
            k, process = active[channel]
            done = _received(channel) if ready else None
            if done is not None:
                left[k].remove(done.number)
                yield done
                continue
            process.join(timeout=5.0 if ready else 0.0)
            hangs = process.is_alive()
            process.kill()
            process.join()
            del active[channel]
            if left[k] and process.exitcode != 0:
                why = "hangs" if hangs else f"died with {process.exitcode}"
                yield Done(left[k].pop(0), "", None, [f"LOST worker: {why}"])
            if left[k]:
                _start(job, left[k], k, active)


def _received(channel: Connection) -> Done | None:
    """What a worker says; None if it has ended."""
    try:
        done = channel.recv()
    except EOFError:
        return None
    assert isinstance(done, Done)
    return done


def _start(
    job: Job,
    numbers: list[int],
    k: int,
    active: dict[Connection, tuple[int, multiprocessing.process.BaseProcess]],
) -> None:
    fork = multiprocessing.get_context("fork")
    here, there = fork.Pipe(duplex=False)
    process = fork.Process(target=_work, args=(job, numbers[:_RENEWED], there), daemon=True)
    process.start()
    there.close()
    active[here] = (k, process)


def _work(job: Job, numbers: list[int], channel: Connection) -> None:
    prepare()
    for number in numbers:
        channel.send(run_case(job, number))
    channel.close()
    os._exit(0)


def run_case(job: Job, number: int) -> Done:
    """Make, run and clear away one case in this process."""
    folder = Path(tempfile.mkdtemp(prefix="imucalib-fuzz-"))
    try:
        case = cases.make(job.seed, number, job.kinds, folder, runs=job.runs)
        code, findings = check(case)
        return Done(number, case.what, code, findings)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
