"""How a study gets on: a bar on a terminal, else a line now and then; how long it will take."""

from __future__ import annotations

import sys
import threading
import time
from typing import TYPE_CHECKING, Self

from imucalib_cli.cli.output import is_terminal, say
from imucalib_cli.cli.progress import ProgressBar

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

PATIENCE = 5.0
"""s before anything is said where no bar is."""
_PARTS = 10
"""Lines of a whole study."""


class StudyProgress:
    """Context manager that is told how many runs are done."""

    def __init__(self, name: str, file: Path, *, jobs: int, quiet: bool) -> None:
        """Name the study, its rows, and how many runs are done at once."""
        self._name, self._file, self._jobs = name, file, jobs
        terminal = is_terminal(sys.stderr)
        self._bar = ProgressBar(enabled=terminal and not quiet)
        self._lines = not terminal and not quiet
        self._quiet = quiet
        self._lock = threading.Lock()
        self._begun = time.monotonic()
        self._before: int | None = None
        self._done = self._all = 0
        self._said: int | None = None
        self._timer = threading.Timer(PATIENCE, self._say_begun)
        self._timer.daemon = True

    def __enter__(self) -> Self:
        self._bar.__enter__()
        if self._lines:
            self._timer.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._timer.cancel()
        self._lines = False
        self._bar.__exit__(kind, error, trace)

    @property
    def before(self) -> int:
        """Runs that an earlier session did."""
        return self._before or 0

    def report(self, done: int, of: int) -> None:
        """Say how many runs are done; the first time, how many an earlier session did."""
        if self._before is None:
            self._before, self._begun = done, time.monotonic()
        self._done, self._all = done, of
        words = f"{done} of {of} runs{self._left()}"
        self._bar.report(f"{self._name}: {words}", done / max(of, 1))
        if not self._lines or time.monotonic() - self._begun < PATIENCE:
            return
        self._say_begun()
        with self._lock:
            part = done * _PARTS // max(of, 1)
            if self._said is not None and part > self._said:
                self._said = part
                say(self._name, words)

    def tell_interrupted(self, *, fresh: bool) -> None:
        """Say what an interruption leaves."""
        if self._quiet or not self._all:
            return
        self._quiet = True  # once is enough
        again = f"the same command {'without --fresh ' if fresh else ''}goes on"
        kept = f"{self._done} of {self._all} runs are kept in {self._file}; {again}"
        say("interrupted", kept if self._done else f"none of {self._all} runs was done")

    def _say_begun(self) -> None:
        with self._lock:
            if not self._lines or self._said is not None or self._before is None:
                return
            self._said = self._done * _PARTS // max(self._all, 1)
            before = f", {self._before} of them done before" if self._before else ""
            say(self._name, f"{self._all} runs{before}, rows in {self._file}")

    def _left(self) -> str:
        """How long the rest will take if it takes as long as what was done in this session."""
        here = self._done - self.before
        if here < self._jobs or self._done == self._all:
            return ""
        each = (time.monotonic() - self._begun) / here
        return f", about {_duration(each * (self._all - self._done))} left"


def _duration(seconds: float) -> str:
    """Such as 40 s, 12 min or 2.5 h."""
    if seconds < 90.0:
        return f"{max(10 * round(seconds / 10.0), 10)} s"
    if seconds < 90.0 * 60.0:
        return f"{round(seconds / 60.0)} min"
    return f"{seconds / 3600.0:.1f} h"
