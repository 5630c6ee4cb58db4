"""Progress: a bar on a terminal; elsewhere long work prints a line now and then."""

from __future__ import annotations

import sys
import threading
import time
from contextlib import ExitStack
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any

from imucalib_cli.cli.interruption import last_words
from imucalib_cli.cli.output import is_quiet, say, say_text, takes_codes
from imucalib_cli.shown import printable

if TYPE_CHECKING:
    from pathlib import Path

    from rich.progress import Progress
    from typing_extensions import Self

PATIENCE = 2.0
"""s until the bar appears."""
LINE_PATIENCE = 5.0
"""s until the first line where no bar is."""
_LINES = 10
"""Lines for the whole work."""
_OFF = "\r\x1b[2K\x1b[?25h"
"""Clears a terminal's line and shows its cursor again (ECMA-48, xterm)."""


class ProgressBar:
    """Context manager; any thread may call :meth:`report`, as often as it likes.

    The bar appears on stderr after two seconds, if stderr is a terminal.
    """

    def __init__(self) -> None:
        self._enabled = takes_codes(sys.stderr) and not is_quiet()
        self._lock = threading.Lock()
        self._state: dict[str, Any] = {"description": "starting", "total": None, "completed": 0.0}
        self._bar: Progress | None = None
        self._leaving = ExitStack()
        self._timer = threading.Timer(PATIENCE, self._appear)
        self._timer.daemon = True

    def __enter__(self) -> Self:
        if self._enabled:
            self._leaving.enter_context(last_words(self._break_off))
            self._timer.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._timer.cancel()
        with self._lock:
            self._enabled = False
            if self._bar is not None:
                self._bar.stop()
        self._leaving.close()

    def report(self, words: str, share: float | None = None) -> None:
        """Show what is being done and its share, 0 to 1, if that is known."""
        total = None if share is None else 1.0
        with self._lock:
            self._state = {
                "description": printable(words),
                "total": total,
                "completed": share or 0.0,
            }
            self._show()

    def _break_off(self) -> None:
        if self._bar is not None:
            sys.stderr = self._bar.console.file  # rich puts its own in front of it
            self._bar.console.quiet = True
            say_text(_OFF)

    def _appear(self) -> None:
        # rich is imported only now: most runs end earlier
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        with self._lock:
            if not self._enabled:
                return
            self._bar = Progress(
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TimeElapsedColumn(),
                console=Console(file=sys.stderr),
                transient=True,
            )
            self._bar.add_task("", total=None)
            self._bar.start()
            self._show()

    def _show(self) -> None:
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], **self._state)


@dataclass(eq=False)
class CountProgress:
    """Context manager for many tasks of one kind: how many are done and how long the rest takes.

    When it is interrupted it says how many are kept in ``place``, and how to go on. ``kept`` names
    what ``place`` holds, such as rows.
    """

    name: str
    noun: str
    place: Path | None
    kept: str = ""
    _: KW_ONLY
    fresh: bool
    jobs: int

    def __post_init__(self) -> None:
        self._bar = ProgressBar()
        self._leaving = ExitStack()
        self._is_quiet = is_quiet()
        self._lines = not takes_codes(sys.stderr) and not self._is_quiet
        self._lock = threading.Lock()
        self._begun = time.monotonic()
        self._before: int | None = None
        self._done = self._all = 0
        self._said: int | None = None
        self._timer = threading.Timer(LINE_PATIENCE, self._say_begun)
        self._timer.daemon = True

    def __enter__(self) -> Self:
        self._leaving.enter_context(last_words(self._say_interrupted))
        self._leaving.enter_context(self._bar)
        if self._lines:
            self._timer.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._timer.cancel()
        self._lines = False
        self._leaving.close()
        if kind is KeyboardInterrupt:
            self._say_interrupted()

    @property
    def before(self) -> int:
        """Number that an earlier session did."""
        return self._before or 0

    @property
    def _counted(self) -> str:
        """The noun, singular for one."""
        return self.noun.removesuffix("s") if self._all == 1 else self.noun

    def report(self, done: int, of: int) -> None:
        """Report how many are done; the first call tells how many an earlier session did."""
        if self._before is None:
            self._before, self._begun = done, time.monotonic()
        self._done, self._all = done, of
        words = f"{done} of {of} {self._counted}{self._time_left()}"
        self._bar.report(f"{self.name}: {words}", done / max(of, 1))
        if not self._lines or time.monotonic() - self._begun < LINE_PATIENCE:
            return
        self._say_begun()
        with self._lock:
            part = done * _LINES // max(of, 1)
            if self._said is not None and part > self._said:
                self._said = part
                say(self.name, words)

    def _say_interrupted(self) -> None:
        if self._is_quiet or not self._all or self.place is None:
            return
        self._is_quiet = True  # once is enough
        again = f"the same command {'without --fresh ' if self.fresh else ''}goes on"
        kept = f"{self._done} of {self._all} {self._counted} are kept in {self.place}; {again}"
        say("interrupted", kept if self._done else f"none of {self._all} {self._counted} was done")

    def _say_begun(self) -> None:
        with self._lock:
            if not self._lines or self._said is not None or self._before is None:
                return
            self._said = self._done * _LINES // max(self._all, 1)
            before = f", {self._before} of them done before" if self._before else ""
            kept = f", {self.kept} in {self.place}" if self.kept else ""
            say(self.name, f"{self._all} {self._counted}{before}{kept}")

    def _time_left(self) -> str:
        """The time for the rest, at the speed of this session."""
        here = self._done - self.before
        if here < self.jobs or self._done == self._all:
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
