"""Read the files of earlier runs: results, and the statistics beside them."""

from __future__ import annotations

import re
import sys
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING
from zipfile import BadZipFile, ZipFile

from imucalib_cli.errors import ChoiceError, ImucalibError, InputError, collected
from imucalib_cli.guarded_yaml import YamlError, read_bounded
from imucalib_cli.logs.remote.url import is_url
from imucalib_cli.results.codec import read_results
from imucalib_cli.shown import as_word, natural_key, path_text, without_secrets

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from imucalib_cli.results.result import Result
    from imucalib_cli.results.statistics_file import StoredLog

    Named = tuple[str, Result]

_SUFFIXES = {".yaml", ".yml", ".json"}
_STATISTICS = ".npz"
_OPENING = re.compile(rb"\A\s*(?:#[^\n]*\n\s*)*(?:---\s*)?[\[{\s]*\"?schema\"?\s*:")
"""First key of a result document, whatever the file's name."""
_RESULT = re.compile(_OPENING.pattern + rb"[^\n]*?[\s,]\"?status\"?\s*:")
"""First keys of a result; the answers of verify and other commands have another second key."""


def is_result(name: str) -> bool:
    """Whether an argument is a result rather than a log; ``-`` is one."""
    if name == "-" or is_url(name):
        return name == "-"
    path = Path(name)
    if path.name == "metadata.yaml" or path.is_dir():  # of a ROS 2 recording
        return False
    if path.suffix.lower() in _SUFFIXES:
        return True
    try:  # a pipe cannot be read twice, and opening one may wait
        return path.is_file() and _begins(path, _OPENING)
    except OSError:
        return False


def result_names(names: Sequence[str]) -> list[str]:
    """Every result file once; of a folder the results in it, sorted by name.

    Raises:
        InputError: There is none, or a folder cannot be read.
    """
    found: dict[str, None] = {}
    for name in names:
        folder = Path(name)
        if name == "-" or not folder.is_dir():
            found[name] = None
            continue
        try:
            there = (each for each in folder.iterdir() if each.suffix.lower() in _SUFFIXES)
            files = sorted(there, key=lambda each: natural_key(each.name))
            results = [each for each in files if each.is_file() and _begins(each, _RESULT)]
        except OSError as error:
            raise InputError(
                f"{folder}: cannot be read ({error.strerror}): check the path"
            ) from error
        found |= dict.fromkeys(map(str, results))
    if not found:
        raise InputError(f"{', '.join(names)}: no result of imucalib run in it")
    return list(found)


def _begins(path: Path, pattern: re.Pattern[bytes]) -> bool:
    with path.open("rb") as file:
        return bool(pattern.match(file.read(4096)))


def read_result_file(name: str) -> list[Result]:
    """Results of a file, or of standard input for ``-``; at least one.

    Raises:
        InputError: The file cannot be read or holds no result.
    """
    return read_results(read_text(name), display_name(name))


def read_result_files(names: Sequence[str]) -> tuple[list[Named], list[ImucalibError]]:
    """Results of several files, each with its file's name in messages, and what cannot be read.

    Raises:
        InputError: As :func:`result_names`.
    """
    found: list[Named] = []
    failures: list[ImucalibError] = []
    for name in result_names(names):
        with collected(failures):
            found += [(display_name(name), result) for result in read_result_file(name)]
    return found, failures


def results_of(found: Sequence[Named], imus: Sequence[str]) -> list[Named]:
    """The results of some IMUs, by frame (with or without a leading slash) or topic.

    Without IMUs all results.

    Raises:
        ChoiceError: An IMU is in none of the files.
    """
    known = [({r.child, f"/{r.child}", r.imu_topic}, (file, r)) for file, r in found]
    for imu in imus:
        if not any(imu in names for names, _ in known):
            files = ", ".join(dict.fromkeys(file for file, _ in found))
            there = ", ".join(dict.fromkeys(f"{r.child} ({r.imu_topic})" for _, r in found))
            raise ChoiceError(f"--imu {imu}: not in {files}; there are: {there}")
    return [each for names, each in known if not imus or not names.isdisjoint(imus)]


def display_name(name: str) -> str:
    """Name of an argument in messages."""
    return "standard input" if name == "-" else path_text(without_secrets(name))


def read_text(name: str, expected: str = "a result of imucalib run") -> str:
    """Content of a small text file, or of standard input for ``-``.

    Raises:
        InputError: It cannot be read, is not text, or is too large.
    """
    shown = display_name(name)
    if is_url(name):
        raise InputError(f"{shown}: is a URL; results are read from disk: download it")
    try:
        if name == "-":
            if sys.stdin is None:
                raise InputError("standard input is closed: name the file")
            return read_bounded(sys.stdin.buffer)
        with Path(name).open("rb") as file:
            return read_bounded(file)
    except OSError as error:
        raise InputError(f"{shown}: cannot be read ({error.strerror}): check the path") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{shown}: is not text: it should be {expected}") from error
    except YamlError as error:
        raise InputError(f"{shown}: {error}: it should be {expected}") from error


def read_statistics_files(
    paths: Iterable[Path],
) -> tuple[list[StoredLog], list[Path], list[ImucalibError]]:
    """Read statistics: files, files beside results, or all files in folders.

    A bad file in a folder does not stop the others.

    Returns:
        The statistics; archives of something else in folders; why other files there are not used.

    Raises:
        InputError: A named file cannot be used, or a folder or a result has no statistics.
    """
    from imucalib_cli.results.statistics_file import read_statistics  # with all of the estimator

    logs: list[StoredLog] = []
    foreign: list[Path] = []
    failures: list[ImucalibError] = []
    for path in paths:
        if not path.is_dir():
            logs += _statistics_of(path)
            continue
        files = sorted(path.glob(f"*{_STATISTICS}"), key=lambda each: natural_key(each.name))
        others = [file for file in files if _is_foreign(file)]
        if len(others) == len(files):
            raise InputError(
                f"{path}: no statistics in it: `imucalib batch LOGS -o {as_word(path)} "
                "--statistics` writes them"
            )
        foreign += others
        for file in (each for each in files if each not in others):
            with collected(failures):
                logs.append(read_statistics(file))
    return logs, foreign, failures


def _is_foreign(file: Path) -> bool:
    """Whether a file is a sound archive of something else; a damaged one may be ours."""
    try:
        with ZipFile(file) as archive:
            return "header.npy" not in archive.namelist()
    except (OSError, BadZipFile, ValueError):
        return False


def _statistics_of(path: Path) -> list[StoredLog]:
    from imucalib_cli.results.statistics_file import place_of, read_statistics

    if path.suffix.lower() == _STATISTICS or not path.exists():
        return [read_statistics(path)]
    beside = place_of(path)
    results = read_result_file(str(path))
    near = sorted({beside, *path.parent.glob(f"{escape(path.name.split('.')[0])}*{_STATISTICS}")})
    # Several IMUs have their frames in the file names; a batch names files after the log.
    logs = [read_statistics(file) for file in near if file.exists()]
    own = [log for log in logs if log.result in results]
    if not own:
        raise InputError(
            f"{path}: no statistics of this result next to it: `imucalib run LOG -o "
            f"{as_word(path)} --statistics {as_word(beside)}` writes both"
        )
    return own
