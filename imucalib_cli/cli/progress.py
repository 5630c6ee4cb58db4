"""A progress bar on stderr, only for a terminal and only for what takes longer than two seconds."""

from __future__ import annotations

import sys
import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING, Self

from imucalib_cli.cli.entry import last_words
from imucalib_cli.shown import shown

if TYPE_CHECKING:
    from types import TracebackType

    from rich.progress import Progress, TaskID

PATIENCE = 2.0
"""s before the bar appears."""
_OFF = "\r\x1b[2K\x1b[?25h"
"""Clears a terminal's line and shows its cursor again, as ECMA-48 and xterm have it."""


class ProgressBar:
    """Context manager whose :meth:`report` may be called as often as one likes, from any thread."""

    def __init__(self, *, enabled: bool) -> None:
        self._enabled = enabled
        self._lock = threading.Lock()
        self._words = "starting"
        self._share: float | None = None
        self._bar: Progress | None = None
        self._task: TaskID | None = None
        self._leaving = ExitStack()
        self._timer = threading.Timer(PATIENCE, self._appear)
        self._timer.daemon = True

    def __enter__(self) -> Self:
        if self._enabled:
            self._leaving.enter_context(last_words(self._break_off))
            self._timer.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._timer.cancel()
        with self._lock:
            self._enabled = False
            if self._bar is not None:
                self._bar.stop()
        self._leaving.close()

    def report(self, words: str, share: float | None = None) -> None:
        """Say what is being done and which share of it, 0 to 1, if that is known."""
        with self._lock:
            self._words, self._share = shown(words), share
            self._show()

    def _break_off(self) -> None:
        if self._bar is not None:
            sys.stderr = self._bar.console.file  # rich puts its own in front of it
            self._bar.console.quiet = True
            sys.stderr.write(_OFF)

    def _appear(self) -> None:
        # rich is imported only now: most runs end before
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
            self._task = self._bar.add_task(self._words, total=None)
            self._bar.start()
            self._show()

    def _show(self) -> None:
        if self._bar is None or self._task is None:
            return
        total = None if self._share is None else 1.0
        self._bar.update(
            self._task, description=self._words, total=total, completed=self._share or 0.0
        )
