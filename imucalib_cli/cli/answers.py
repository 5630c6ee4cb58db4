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
    from collections.abc import Sequence
    from pathlib import Path

    from imucalib_cli.errors import ImucalibError

CODES = {
    "yes": EXIT_OK,
    "not moved": EXIT_OK,
    "no": EXIT_NO,
    "moved": EXIT_NO,
    "unknown": EXIT_UNTRUSTED,
}
"""Exit code of each verdict."""


def give_answers(
    documents: Sequence[dict[str, Any]],
    failures: Sequence[ImucalibError],
    *,
    fmt: str,
    output: Path | None,
    quiet: bool,
) -> int:
    """Write documents and sentences; the exit code is that of the worst IMU."""
    from imucalib_cli.results.text import to_json, to_yaml

    if documents:
        text = to_json(list(documents)) if fmt == "json" else to_yaml(list(documents))
        deliver(text, output)
    for document in documents:
        if not quiet:
            say(document["verdict"], document["reason"])
    for failure in failures:
        say("error", failure)
    verdicts = [CODES[document["verdict"]] for document in documents]
    return worst([*verdicts, *(exit_code(failure) for failure in failures)])
