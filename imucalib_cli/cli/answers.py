"""Deliver the answers of ``verify`` and ``diff``: documents, a sentence each, one exit code."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from imucalib_cli.cli.output import (
    EXIT_NO,
    EXIT_OK,
    EXIT_UNTRUSTED,
    deliver,
    exit_code,
    is_folder,
    say,
    worst,
)
from imucalib_cli.errors import ChoiceError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from imucalib_cli.jobs.verify import Answers

CODES = {
    "yes": EXIT_OK,
    "not moved": EXIT_OK,
    "no": EXIT_NO,
    "moved": EXIT_NO,
    "unknown": EXIT_UNTRUSTED,
}
"""Exit code of each verdict."""


def see_answer_writable(output: str | None, inputs: Iterable[Path]) -> None:
    """See before any computing that answers can go where they shall.

    Raises:
        ChoiceError: A folder was named, or an input.
        InputError: The file cannot be written.
    """
    if output is None or output == "-":
        return
    if is_folder(output):
        raise ChoiceError(f"-o {output}: is a folder; name the file to write")
    from imucalib_cli.results.atomic import see_writable

    see_writable(Path(output), inputs=inputs)


def give_answers(
    given: Answers[Any], *, fmt: str, output: str | None, inputs: Iterable[Path], quiet: bool
) -> int:
    """Write answers and a sentence each; the exit code is that of the worst IMU."""
    from imucalib_cli.results.codec import to_json, to_yaml

    answers, failures = given.answers, given.failures
    if answers:
        text = to_json(answers) if fmt == "json" else to_yaml(answers)
        deliver(text, None if output is None else Path(output), inputs=[*inputs, *given.files])
    for answer in answers:
        if not quiet:
            say(answer.verdict, answer.reason)
    for failure in failures:
        say("error", failure)
    verdicts = [CODES[answer.verdict] for answer in answers]
    return worst([*verdicts, *(exit_code(failure) for failure in failures)])
