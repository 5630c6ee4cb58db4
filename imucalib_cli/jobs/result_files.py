"""Result files of earlier runs: recognise them among arguments, and read them."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError, ImucalibError, InputError
from imucalib_cli.guarded_yaml import YamlError, read_bounded
from imucalib_cli.logs.remote.url import is_url
from imucalib_cli.results.codec import read_results
from imucalib_cli.shown import natural, without_secrets

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.results.result import Result

_SUFFIXES = {".yaml", ".yml", ".json"}
_OPENING = re.compile(rb"\A\s*(?:#[^\n]*\n\s*)*(?:---\s*)?[\[{\s]*\"?schema\"?\s*:")
"""First key of a result document, whatever the file's name."""
_RESULT = re.compile(_OPENING.pattern + rb"[^\n]*?[\s,]\"?status\"?\s*:")
"""First keys of a result; answers of verify and others have other ones after the first."""


def is_result(name: str) -> bool:
    """Whether an argument is a result rather than a log; ``-`` is one."""
    if name == "-":
        return True
    if is_url(name):
        return False
    path = Path(name)
    if path.name == "metadata.yaml" or path.is_dir():  # of a ROS 2 recording
        return False
    try:
        if not path.is_file():  # a pipe cannot be read twice, and opening one may wait
            return path.suffix.lower() in _SUFFIXES
        with path.open("rb") as file:
            return path.suffix.lower() in _SUFFIXES or bool(_OPENING.match(file.read(4096)))
    except OSError:
        return path.suffix.lower() in _SUFFIXES


def result_names(names: Sequence[str]) -> list[str]:
    """Every result file once, those of a folder by name.

    Args:
        names: Result files; folders of them, of which other files are passed over; ``-`` is
            standard input.

    Raises:
        InputError: There is none, or a folder cannot be read.
    """
    found: dict[str, None] = {}
    for name in names:
        is_folder = name != "-" and Path(name).is_dir()
        found |= dict.fromkeys(results_in(Path(name)) if is_folder else [name])
    if not found:
        raise InputError(f"{', '.join(names)}: no result of imucalib run in it")
    return list(found)


def results_in(folder: Path) -> list[str]:
    """Result files of a folder by name, numbers as numbers; what else lies there is passed over.

    Raises:
        InputError: The folder cannot be read.
    """
    try:
        there = (each for each in folder.iterdir() if each.suffix.lower() in _SUFFIXES)
        files = sorted(there, key=lambda each: natural(each.name))
        return [str(each) for each in files if each.is_file() and _opens_as_result(each)]
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror}): check the path") from error


def _opens_as_result(path: Path) -> bool:
    with path.open("rb") as file:
        return bool(_RESULT.match(file.read(4096)))


def read_result_file(name: str) -> list[Result]:
    """Results of a file, or of standard input for ``-``; at least one.

    Raises:
        InputError: The file cannot be read or holds no result.
    """
    return read_results(read_text(name), display_name(name))


def read_result_files(
    names: Sequence[str],
) -> tuple[list[tuple[str, Result]], list[ImucalibError]]:
    """Results of several files, each with its file's name in messages, and what cannot be read.

    Args:
        names: As of :func:`result_names`.

    Raises:
        InputError: As :func:`result_names`.
    """
    found: list[tuple[str, Result]] = []
    failures: list[ImucalibError] = []
    for name in result_names(names):
        try:
            found += [(display_name(name), result) for result in read_result_file(name)]
        except ImucalibError as error:
            failures.append(error)
    return found, failures


def results_of(
    found: Sequence[tuple[str, Result]], imus: Sequence[str]
) -> list[tuple[str, Result]]:
    """Select the results of some IMUs by frame (with or without a leading slash) or topic.

    Args:
        found: Results, each with its file's name.
        imus: Frames or topics; empty takes all.

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
    return "standard input" if name == "-" else without_secrets(name)


def read_text(name: str, expected: str = "a result of imucalib run") -> str:
    """Content of a small text file, or of standard input for ``-``.

    Args:
        name: Of the file.
        expected: What it should be, for a message.

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
