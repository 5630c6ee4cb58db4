"""Errors that a user can correct: one class for each exit code."""

from __future__ import annotations

from contextlib import contextmanager
from copy import copy
from typing import TYPE_CHECKING

from imucalib_cli.findings import Finding
from imucalib_cli.shown import printable, without_secrets

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from typing_extensions import Self

FEWER_TOPICS = "fewer topics (--imu-topic, --joint-topic, --pose-topic)"
"""What reduces the memory that a log needs."""


class ImucalibError(Exception):
    """Base of every error a user may see; its text is one line that names the remedy.

    Attributes:
        finding: The finding behind the error, if any.
        topic: The topic that the text names, if any.
        option: The one option that would solve it, such as ``--parent``, if there is one.
        reason: The text without its candidates, if it has any.
    """

    def __init__(
        self,
        message: str | Finding = "",
        *,
        topic: str | None = None,
        option: str | None = None,
        reason: str | None = None,
    ) -> None:
        self.finding = message if isinstance(message, Finding) else None
        if isinstance(message, Finding):
            named = message.values.get("topic")
            topic = topic or (named if isinstance(named, str) else None)
            message = message.message
        super().__init__(printable(without_secrets(message)))
        self.topic, self.option, self.reason = topic, option, reason

    def about(self, name: str) -> Self:
        """The same error, with a file or a topic in front of its text."""
        error = copy(self)
        error.args = (f"{name}: {self}",)
        return error

    def followed_by(self, reasons: Iterable[str]) -> Self:
        """The same error, with further reasons after its text."""
        error = copy(self)
        error.args = ("; ".join((str(self), *reasons)),)
        return error


@contextmanager
def collected(failures: list[ImucalibError]) -> Iterator[None]:
    """Add an error to the failures in place of raising it, where the work goes on without it."""
    try:
        yield
    except ImucalibError as error:
        failures.append(error)


class InputError(ImucalibError):
    """An input cannot be used; says which file and topic, why, and what to do (exit code 1)."""


class ChoiceError(ImucalibError):
    """The user must choose, or named something missing; lists the candidates (exit code 2)."""


class UntrustedError(ImucalibError):
    """A result cannot be given, or must not be used for this without ``--force`` (exit code 3)."""
