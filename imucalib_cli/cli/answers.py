"""Deliver the answers of ``verify`` and ``diff``: documents, a sentence each, one exit code."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from imucalib_cli.cli.output import (
    EXIT_NO,
    EXIT_OK,
    EXIT_UNTRUSTED,
    deliver,
    exit_code,
    say,
    worst,
)

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.jobs.verify import Answers

CODES = {
    "yes": EXIT_OK,
    "not moved": EXIT_OK,
    "no": EXIT_NO,
    "moved": EXIT_NO,
    "unknown": EXIT_UNTRUSTED,
}
"""Exit code of each verdict."""


def give_answers(given: Answers[Any], *, fmt: str, output: Path | None, quiet: bool) -> int:
    """Write answers and a sentence each; the exit code is that of the worst IMU."""
    from imucalib_cli.results.codec import to_json, to_yaml

    answers, failures = given.answers, given.failures
    if answers:
        text = to_json(answers) if fmt == "json" else to_yaml(answers)
        deliver(text, output)
    for answer in answers:
        if not quiet:
            say(answer.verdict, answer.reason)
    for failure in failures:
        say("error", failure)
    verdicts = [CODES[answer.verdict] for answer in answers]
    return worst([*verdicts, *(exit_code(failure) for failure in failures)])
