"""The work on one log, in any process: from its files to the content of its results."""

from __future__ import annotations

import os
import platform
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from imucalib_cli import __version__
from imucalib_cli.batch.content_key import key_of, sizes_of, stamps_of, urdf_hash
from imucalib_cli.batch.record import Record
from imucalib_cli.errors import FEWER_TOPICS, ImucalibError, InputError
from imucalib_cli.jobs.calibrate import calibrate
from imucalib_cli.logs.unpacked import removing_copies
from imucalib_cli.process import one_thread
from imucalib_cli.results.formats import FORMATS
from imucalib_cli.results.names import shortened, stems_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from imucalib_cli.batch.content_key import Sizes
    from imucalib_cli.batch.logs import BatchLog
    from imucalib_cli.batch.record import FileStamp
    from imucalib_cli.jobs.calibrate import Outcome
    from imucalib_cli.jobs.input.request import CalibrationRequest
    from imucalib_cli.results.result import Result

    Content = str | bytes
    Maker = Callable[[Path, Outcome], Iterable[tuple[Path, Content]]]
    """From the path of the first file and the outcome to the files of one kind."""
    ExitCode = Callable[[Iterable[ImucalibError], Sequence[Result]], int]

_NAME = 100
"""Bytes of the name of a log in that of a file, which leaves as many for the IMU."""


@dataclass(frozen=True, kw_only=True)
class Done:
    """The work of a worker on one log, of which nothing is written yet."""

    record: Record
    contents: tuple[tuple[str, Content], ...]
    """Names in the folder of results, and what the files hold."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """The work on each log of a batch."""

    request: CalibrationRequest
    """Without a log."""
    context: str
    """As content_key.context_of has it."""
    urdf_sha256: str | None
    exit_code: ExitCode
    """From errors and results to an exit code."""
    extras: tuple[tuple[str, Maker], ...] = ()
    """Files beside the results: suffix after the log's name, and maker."""
    keeps_files: bool = True
    """Whether to make files beside the record."""
    folder: Path | None = None
    """Working folder of the command, for workers on other machines."""
    version: str = __version__

    @property
    def modules(self) -> set[str]:
        """Modules that a worker imports to unpickle the task."""
        functions = (self.exit_code, *(make for _, make in self.extras))
        return {function.__module__ for function in functions}

    def __call__(self, log: BatchLog) -> Done:
        """Calibrate a log; every error is in the record."""
        begun = time.perf_counter()
        sizes: Sizes = {}
        results: tuple[Result, ...] = ()
        errors: list[ImucalibError] = []
        contents: dict[str, Content] = {}
        stamps: list[FileStamp] = []
        try:
            self._check_worker(log)
            sizes = sizes_of(log)
            outcome = self._outcome(log)
            if not self._has_its_urdf():
                raise _PassingError(  # noqa: TRY301 - recorded like all errors
                    f"{self.request.urdf} has changed since the batch began, or differs on "
                    "the worker: run the same command again"
                )
            results, errors = outcome.results, list(outcome.failures)
            files = outcome.recording.files()
            hashes = {each.path: each.sha256 for each in files if each.sha256 is not None}
            stamps = stamps_of(sizes, hashes=hashes)
            contents = dict(self._files(log, outcome, errors)) if self.keeps_files else {}
        except Exception as error:  # noqa: BLE001 - one log must not stop the others
            errors.append(_in_our_words(error))
        is_whole = sizes == sizes_of(log) and self._has_its_urdf()
        # otherwise the next try may succeed: a full disk, a package that is not installed
        is_lasting = not any(
            isinstance(error, _PassingError) or isinstance(error.__cause__, (OSError, ImportError))
            for error in errors
        )
        with suppress(OSError):  # the log cannot be read
            stamps = stamps or stamps_of(sizes)
        record = self._record(
            log,
            errors,
            results,
            seconds=round(time.perf_counter() - begun, 3),
            key=key_of(self.context, stamps) if is_whole and is_lasting else None,
            written=list(contents),
            files=stamps,
        )
        return Done(record=record, contents=tuple(contents.items()))

    def lost(self, log: BatchLog, reason: str) -> Done:
        """The record of a log whose worker was lost; it is done again the next time."""
        return Done(record=self._record(log, [InputError(reason)]), contents=())

    def late(self, log: BatchLog, seconds: float) -> Done:
        """The record of a log that exceeded its time limit."""
        reason = (
            f"not finished within --timeout {seconds:g} s: run the same command again with more"
        )
        return self.lost(log, reason)

    def _record(
        self,
        log: BatchLog,
        errors: Sequence[ImucalibError],
        results: Sequence[Result] = (),
        **more: Any,
    ) -> Record:
        untrusted = any(result.status != "ok" for result in results)
        return Record(
            log=log.label,
            place=log.place,
            status="failed" if errors else "untrusted" if untrusted else "ok",
            exit_code=self.exit_code(errors, results),
            errors=list(map(str, errors)),
            results=list(results),
            **{"seconds": 0.0, "key": None, "written": [], "files": []} | more,
        )

    def _outcome(self, log: BatchLog) -> Outcome:
        request = replace(self.request, logs=log.paths, details=bool(self.extras))
        with one_thread(), removing_copies():
            return calibrate(request)

    def _has_its_urdf(self) -> bool:
        """Whether the URDF is the one that the batch began with."""
        try:
            return urdf_hash(self.request) == self.urdf_sha256
        except InputError:
            return False

    def _files(
        self, log: BatchLog, outcome: Outcome, errors: list[ImucalibError]
    ) -> Iterator[tuple[str, Content]]:
        """The YAML of each IMU, then the extra files; a file that cannot be made is an error."""
        yaml = FORMATS["yaml"]
        stems = stems_of(log.name, outcome.results)
        for (_, stem), result in zip(stems, outcome.results, strict=True):
            yield f"{stem}{yaml.suffix}", yaml.render([result])
        for suffix, make in self.extras if outcome.results else ():
            try:
                for path, content in make(Path(f"{log.name}{suffix}"), outcome):
                    yield path.name, content
            except ImucalibError as error:
                errors.append(error)

    def _check_worker(self, log: BatchLog) -> None:
        """Raise InputError if this worker runs another version, or does not see the files."""
        if self.folder is None:
            return
        here = f"the worker on {platform.node()}"
        if __version__ != self.version:
            raise InputError(
                f"{here} runs imucalib {__version__}, this command {self.version}: install the "
                "same version on all"
            )
        try:
            if not self.folder.samefile(Path.cwd()):
                os.chdir(self.folder)
        except OSError as error:
            raise InputError(f"{here} does not see the folder {self.folder}: {_SHARED}") from error
        for path in (*log.paths, self.request.urdf):
            if isinstance(path, Path) and not path.exists():
                raise InputError(f"{here} does not see {path}: {_SHARED}")


_SHARED = "logs and URDF must be at the same place for all workers, as on a shared file system"


def file_name(log_name: str) -> str:
    """Beginning of the names of a log's files."""
    return shortened(log_name, _NAME).lstrip(".") or "log"


class _PassingError(InputError):
    """An error that may not occur the next time, though the log is the same."""


def _in_our_words(error: Exception) -> ImucalibError:
    if isinstance(error, ImucalibError):
        return error
    if isinstance(error, MemoryError):
        return _PassingError(
            f"not enough memory for this log: raise --memory, or name {FEWER_TOPICS}"
        )
    if isinstance(error, OSError):
        return _PassingError(f"cannot be read any more: {error}")
    return _PassingError(f"internal error: {type(error).__name__}: {error}; please report it")
