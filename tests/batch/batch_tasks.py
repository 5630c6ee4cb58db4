"""Work on logs that is quick, or goes wrong, for the engines; a batch in one process."""

import os
import signal
import tempfile
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imucalib_cli.batch.batch import Batch
from imucalib_cli.batch.content_key import context_of, key_of, sizes_of, stamps_of, urdf_hash
from imucalib_cli.batch.logs import BatchLog, find_logs
from imucalib_cli.batch.task import Done, Task
from imucalib_cli.cli.exit_codes import exit_code_of
from imucalib_cli.jobs.input.request import CalibrationRequest


def here(task: Task, logs: Sequence[BatchLog]) -> Generator[tuple[BatchLog, Done]]:
    """An engine without processes."""
    for log in logs:
        yield log, task(log)


def given(request: CalibrationRequest, **changes: Any) -> dict[str, Any]:
    """What the command makes of its options, for a task."""
    return {
        "request": request,
        "context": context_of(request, [suffix for suffix, _ in changes.get("extras", ())]),
        "urdf_sha256": urdf_hash(request),
        "exit_code": exit_code_of,
        **changes,
    }


def task_for(request: CalibrationRequest | None = None, **changes: Any) -> Task:
    return Task(**given(request or CalibrationRequest(logs=()), **changes))


def batch(folder: Path | None, *names: object, task: Task, **changes: Any) -> Batch:
    found = find_logs(map(str, names), left_out=folder)
    return Batch(logs=found.logs, task=task, folder=folder, **({"engine": here} | changes))


@dataclass(frozen=True, kw_only=True)
class Copying(Task):
    """Takes the text of a log for its result, and does as the text says.

    ``die``: the process is killed; ``die once``: the first time; ``eat``: takes a lot of memory;
    ``sleep``: for a minute.
    """

    traces: Path
    """Folder in which each process leaves its number, and what it worked on."""
    pause: float = 0.0
    frames: tuple[str, ...] = ("a", "b")

    def __call__(self, log: BatchLog) -> Done:
        text = Path(str(log.paths[0])).read_text()
        trace = self.traces / f"{log.name or log.paths[0].stem}.{time.monotonic_ns()}"
        trace.write_text(str(os.getpid()))
        tries = len(list(self.traces.glob(f"{log.name or log.paths[0].stem}.*")))
        with (self.traces.parent / "temporary").open("a") as file:
            file.write(tempfile.mkdtemp() + "\n")  # which a process that is killed cannot remove
        if text == "die" or (text == "die once" and tries == 1):
            os.kill(os.getpid(), signal.SIGKILL)
        if text == "sleep":
            for _ in range(600):
                time.sleep(0.1)
        if text == "eat":
            return super().__call__(log)
        time.sleep(self.pause)
        stamps = stamps_of(sizes_of(log))
        names = [f"{log.name}.{imu}.yaml" for imu in ("a" if "one" in text else self.frames)]
        key = key_of(self.context, stamps)
        record = self._record(log, [], key=key, written=names, files=stamps)
        return Done(record=record, contents=tuple((name, text) for name in names))

    def _outcome(self, log: BatchLog) -> Any:  # noqa: ARG002 - as it is overridden
        return bytearray(8 << 30)


def copying(traces: Path, **changes: Any) -> Copying:
    traces.mkdir(exist_ok=True)
    return Copying(**given(CalibrationRequest(logs=()), traces=traces, **changes))


def main(folder: str, logs: str, traces: str, pause: str) -> None:
    """A batch for a process that is to be killed."""
    task = copying(Path(traces), pause=float(pause))
    for _ in batch(Path(folder), logs, task=task).run():
        pass


if __name__ == "__main__":
    import sys

    main(*sys.argv[1:])
