"""Results and answers of commands: to stdout or a file, and what stdout does not say to stderr."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

from imucalib_cli.cli.output import (
    chosen_format,
    deliver,
    explain_sigma,
    finish,
    is_quiet,
    is_terminal,
    remark,
    say,
    say_error,
    say_text,
    show,
    wants_colour,
)
from imucalib_cli.errors import ImucalibError, UntrustedError
from imucalib_cli.layout import plain
from imucalib_cli.results.formats import FORMATS, refuse_untrusted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from imucalib_cli.results.result import Result


def write_results(results: Sequence[Result], fmt: str, target: Path | None) -> None:
    """Write results in a format to a file, or to stdout."""
    if results and fmt == "summary" and target is None:
        show(_in_words(results, sys.stdout))
    elif results:
        deliver(FORMATS[fmt].render(results), target)


def deliverable(results: Sequence[Result], fmt: str, *, force: bool) -> list[Result]:
    """Results that may be written in a format; an error is printed for each other one."""
    usable = []
    for result in results:
        try:
            if FORMATS[fmt].is_bare_pose:
                refuse_untrusted(result, fmt, force=force)
            usable.append(result)
        except UntrustedError as error:
            say_error(error)
    return usable


def _in_words(results: Sequence[Result], stream: TextIO) -> str:
    from imucalib_cli.results.fields import summarise

    return "\n".join(summarise(result, colour=wants_colour(stream)) for result in results)


def report_findings(
    results: Sequence[Result], fmt: str, target: Path | None, *, hint: bool
) -> None:
    """Print on stderr what stdout does not say: the summary on a terminal, else the findings.

    Where stdout has words, a ``hint`` says how to get the result as YAML.
    """
    if is_quiet():
        return
    from imucalib_cli.results.fields import findings_of, reasons

    in_words = fmt == "summary" and target is None
    if is_terminal(sys.stderr) and not (in_words or (target is None and is_terminal(sys.stdout))):
        say_text(_in_words(results, sys.stderr))
    elif not (is_terminal(sys.stderr) and in_words):
        # a cause that was found comes first, its effects follow
        lines = [
            ("untrusted", f"{result.child}: {reason}")
            for result in results
            for reason in reasons(result)
        ]
        lines += [(finding.label, finding.text) for finding in findings_of(results)]
        for label, text in lines:
            say(label, text)
        explain_sigma(text for _, text in lines)
    if results and in_words and hint:
        say("note", "for the result as YAML add -o FILE or --format yaml, or pipe it")


def give_answers(
    answers: Sequence[Any],
    failures: Sequence[ImucalibError],
    findings: Sequence[tuple[str, str]],
    *,
    fmt: str | None,
    output: Path | None,
) -> NoReturn:
    """Write answers, and on stderr a sentence for each; ends with the exit code of the worst IMU.

    ``findings`` are pairs of a label and a sentence.
    """
    from imucalib_cli.results.codec import to_json, to_jsonl, to_yaml
    from imucalib_cli.results.comparison.answers import as_csv

    several = len({answer.about for answer in answers}) + len(failures) > 1

    def to_words(answers: Iterable[Any]) -> str:
        return plain(
            f"{answer.verdict}: {named(answer.about, answer.reason, several=several)}"
            for answer in answers
        )

    renderers: dict[str, Callable[[Any], str]] = {
        "yaml": to_yaml,
        "json": to_json,
        "jsonl": to_jsonl,
        "csv": as_csv,
        "summary": to_words,
    }
    chosen = chosen_format(fmt, output)
    for label, text in findings:
        remark(label, text)
    explain_sigma(text for _, text in findings)
    if answers:
        deliver(renderers[chosen](answers), output)
    if chosen != "summary" or output is not None:
        for answer in answers:
            remark(answer.verdict, named(answer.about, answer.reason, several=several))
    finish(failures, answers=answers)


def named(file: str, sentence: str, *, several: bool) -> str:
    """A sentence on the answer for a file; if there are several, the file comes first."""
    return f"{file}: {sentence}" if several and file else sentence
