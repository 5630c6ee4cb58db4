"""Completions for the shell: topics of the given log, links of the given URDF, names.

A callback reads only the index of a log, and offers nothing if a file cannot be read.
"""

from __future__ import annotations

import signal
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import typer  # noqa: TC002 - typer evaluates the annotations

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from imucalib_cli.logs.messages.table import Kind

    Completion = Callable[[typer.Context], list[str]]

_PATIENCE = 1.0
"""s of computing for one Tab: a log without an index would be read to its end."""


def _completion(names: Callable[[typer.Context], Iterable[str]]) -> Completion:
    """A completion from names; it is silent and soon gives up where they cannot be found."""

    def complete(ctx: typer.Context) -> list[str]:
        found: list[str] = []
        if hasattr(signal, "setitimer"):
            signal.signal(signal.SIGPROF, _give_up)
            signal.setitimer(signal.ITIMER_PROF, _PATIENCE)
        with suppress(Exception):  # the command itself tells what is wrong
            found = list(names(ctx))
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_PROF, 0.0)
        return found  # typer leaves out names that do not begin with what is typed

    return complete


def _give_up(*_: object) -> None:
    raise TimeoutError


def _arguments(ctx: typer.Context, *names: str) -> list[str]:
    """Arguments on the command line; click has not parsed them if the last option has no value."""
    given = next(filter(None, map(ctx.params.get, names)), ctx.args)
    return [given] if isinstance(given, str) else list(given)


def topics(kind: Kind) -> Completion:
    """Topics of a kind in the log on the command line."""

    @_completion
    def names(ctx: typer.Context) -> Iterable[str]:
        from imucalib_cli.logs.log import open_log
        from imucalib_cli.logs.select import candidates

        log = open_log(tuple(map(Path, _arguments(ctx, "logs"))))
        return [each.name for each in candidates(log.topics, kind)]

    return names


@_completion
def links(ctx: typer.Context) -> Iterable[str]:
    """Links of the URDF on the command line."""
    from imucalib_cli.errors import InputError
    from imucalib_cli.robot.expansion import expanded
    from imucalib_cli.robot.urdf_xml import parse_xml

    path = Path(ctx.params["urdf"])
    try:
        root = parse_xml(path.read_bytes(), path)
    except InputError:
        if path.suffix != ".xacro":
            raise
        root = parse_xml(expanded(path, patience=_PATIENCE), path)
    return [link.attributes["name"] for link in root.findall("link")]


@_completion
def imus(ctx: typer.Context) -> Iterable[str]:
    """IMUs of the result on the command line."""
    from imucalib_cli.jobs.result_files import read_result_files

    names = [name for name in _arguments(ctx, "results", "result") if name != "-"]
    results = [result for _, result in read_result_files(names)[0]]
    return [name for each in results for name in (each.child, each.imu_topic)]


@_completion
def imu_models(_: typer.Context) -> Iterable[str]:
    """IMUs of configs/imus."""
    from imucalib_cli.signals.imu.data_sheet import imu_names

    return imu_names()


@_completion
def systems(_: typer.Context) -> Iterable[str]:
    """Systems that can be simulated."""
    from imucalib_cli.simulate.load import system_names

    return system_names()


@_completion
def studies(_: typer.Context) -> Iterable[str]:
    """Studies of the catalogue."""
    from imucalib_cli.study.study import STUDIES

    return STUDIES
