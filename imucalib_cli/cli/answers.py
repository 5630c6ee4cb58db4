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
    from collections.abc import Iterable, Sequence

    from imucalib_cli.errors import ImucalibError

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
    documents: Sequence[dict[str, Any]],
    failures: Sequence[ImucalibError],
    *,
    fmt: str,
    output: str | None,
    inputs: Iterable[Path],
    quiet: bool,
) -> int:
    """Write documents and sentences; the exit code is that of the worst IMU."""
    from imucalib_cli.results.text import to_json, to_yaml

    if documents:
        text = to_json(list(documents)) if fmt == "json" else to_yaml(list(documents))
        deliver(text, None if output is None else Path(output), inputs=inputs)
    for document in documents:
        if not quiet:
            say(document["verdict"], document["reason"])
    for failure in failures:
        say("error", failure)
    verdicts = [CODES[document["verdict"]] for document in documents]
    return worst([*verdicts, *(exit_code(failure) for failure in failures)])
