"""The exit codes: their meanings, and the code of an error. docs/exit-codes.md is made here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from imucalib_cli.cli.interruption import EXIT_INTERRUPTED
from imucalib_cli.errors import ChoiceError, ImucalibError, UntrustedError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from imucalib_cli.results.result import Result

EXIT_OK, EXIT_INPUT, EXIT_USAGE, EXIT_UNTRUSTED, EXIT_NO = 0, 1, 2, 3, 4
EXIT_BROKEN_PIPE = 141


class Meaning(NamedTuple):
    """The meaning of an exit code, for people."""

    brief: str
    full: str
    written: str
    """What is written, and where to."""


EXIT_CODES: dict[int, Meaning] = {
    EXIT_OK: Meaning(
        "trustworthy",
        "The result is trustworthy. `verify`: the pose is right. `diff` and `trend`: the mount has "
        "not moved. `compare`: both could be compared, whatever the difference. `batch`: every log "
        "has trustworthy results. `study`: all its runs are done, whatever they found.",
        "the result, or the answer",
    ),
    EXIT_INPUT: Meaning(
        "input unusable",
        "An input cannot be used: a file is missing, damaged or not what it should be, a topic is "
        "empty, or a sensor is dead or in no known unit. Or an output cannot be written.",
        "one line on stderr: which file or topic, why, what to do",
    ),
    EXIT_USAGE: Meaning(
        "wrong usage or a choice to make",
        "Wrong usage, or a choice that you must make: several candidate topics, a frame or topic "
        "that does not exist, no `--parent` or `--urdf` where one is needed.",
        "one line on stderr with the candidates",
    ),
    EXIT_UNTRUSTED: Meaning(
        "not trustworthy or unknown",
        "A result should not be trusted: a direction that the motion did not determine, a "
        "contradiction in the data, a sigma above `--require`. Or there is none, because nothing "
        "in the log moves. `verify`, `diff` and `trend`: the answer is unknown. `compare`: the "
        "result of `imucalib run` is untrusted. Formats that hold only a pose (`urdf`, `tf`, "
        "`matrix` and others) and `imucalib apply` refuse such a result unless `--force` is given.",
        "the result with `status: untrusted`, and the reasons on stderr; only one line if nothing "
        "moves",
    ),
    EXIT_NO: Meaning(
        "the pose is not as given or has moved",
        "`verify`: the pose found is not the given one. `diff` and `trend`: the mount has moved.",
        "the answer, with the difference and its significance",
    ),
    EXIT_INTERRUPTED: Meaning(
        "interrupted",
        "Interrupted by Ctrl-C (SIGINT), SIGTERM or SIGHUP.",
        "nothing; `study` and `batch -o` print in one line how many runs or logs are kept, and "
        "where; the same command continues (not with `--quiet`)",
    ),
    EXIT_BROKEN_PIPE: Meaning(
        "stdout closed",
        "The reader of stdout ended before all was written (as in `imucalib batch … | head`). A "
        "short output fits into the pipe: the code is then one of those above.",
        "what the reader read",
    ),
}
_FROM_BEST = (EXIT_OK, EXIT_UNTRUSTED, EXIT_USAGE, EXIT_INPUT, EXIT_NO)
_VERDICTS = {
    "yes": EXIT_OK,
    "not moved": EXIT_OK,
    "no": EXIT_NO,
    "moved": EXIT_NO,
    "drifting": EXIT_NO,
    "unknown": EXIT_UNTRUSTED,
}
_CODES = {ChoiceError: EXIT_USAGE, UntrustedError: EXIT_UNTRUSTED}


def exit_code(error: ImucalibError) -> int:
    """Exit code of an error."""
    return _CODES.get(type(error), EXIT_INPUT)


def exit_code_of(
    errors: Iterable[ImucalibError], results: Iterable[Result] = (), answers: Iterable[Any] = ()
) -> int:
    """Exit code of a log or a comparison, from errors, results and answers with a verdict."""
    untrusted = [EXIT_UNTRUSTED for result in results if result.status != "ok"]
    verdicts = [_VERDICTS[answer.verdict] for answer in answers]
    return worst([*map(exit_code, errors), *untrusted, *verdicts])


def worst(codes: Iterable[int]) -> int:
    """Exit code of several IMUs, or logs.

    A missing result is worse than an untrusted one. One IMU at a wrong place decides alone.
    """
    return max(codes, key=_FROM_BEST.index, default=EXIT_OK)
