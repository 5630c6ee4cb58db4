"""Completions for the shell: topics of the given log, links of the given URDF, names.

A callback reads only the index of a log, and offers nothing if a file cannot be read.
"""

from __future__ import annotations

import signal
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import typer  # noqa: TC002 - typer evaluates the annotations

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from imucalib_cli.logs.messages.table import Kind

    Completion = Callable[[typer.Context, str], list[str]]

_PATIENCE = 1.0
"""s of computing for one Tab: a log without an index would be read to its end."""


def topics(kind: Kind) -> Completion:
    """Topics of a kind in the log on the command line."""

    def complete(ctx: typer.Context, incomplete: str) -> list[str]:
        found: list[str] = []
        with _quietly():
            from imucalib_cli.logs.log import open_log
            from imucalib_cli.logs.select import candidates

            log = open_log(tuple(map(Path, _arguments(ctx, "logs"))))
            found = [each.name for each in candidates(log.topics, kind)]
        return _beginning(incomplete, found)

    return complete


def links(ctx: typer.Context, incomplete: str) -> list[str]:
    """Links of the URDF on the command line."""
    found: list[str] = []
    with _quietly():
        from imucalib_cli.robot.urdf_xml import parse_xml

        path = Path(ctx.params["urdf"])
        root = parse_xml(path.read_bytes(), path)
        found = [link.attributes["name"] for link in root.findall("link")]
    return _beginning(incomplete, found)


def imus(ctx: typer.Context, incomplete: str) -> list[str]:
    """IMUs of the result on the command line."""
    found: list[str] = []
    with _quietly():
        from imucalib_cli.jobs.result_files import read_result_files

        names = [name for name in _arguments(ctx, "results", "result") if name != "-"]
        for _, result in read_result_files(names)[0]:
            found += [result.child, result.imu_topic]
    return _beginning(incomplete, found)


def imu_models(incomplete: str) -> list[str]:
    """IMUs of configs/imus."""
    from imucalib_cli.signals.imu.data_sheet import imu_names

    return _beginning(incomplete, imu_names())


def systems(incomplete: str) -> list[str]:
    """Systems that can be simulated."""
    from imucalib_cli.simulate.load import system_names

    return _beginning(incomplete, system_names())


def studies(incomplete: str) -> list[str]:
    """Studies of the catalogue."""
    from imucalib_cli.study.study import STUDIES

    return _beginning(incomplete, STUDIES)


@contextmanager
def _quietly() -> Iterator[None]:
    """Give up silently, and soon: the command itself tells what is wrong."""
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGPROF, _give_up)
        signal.setitimer(signal.ITIMER_PROF, _PATIENCE)
    with suppress(Exception):
        yield
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def _give_up(*_: object) -> None:
    raise TimeoutError


def _arguments(ctx: typer.Context, *names: str) -> list[str]:
    """Arguments on the command line; click has not parsed them if the last option has no value."""
    given = next(filter(None, map(ctx.params.get, names)), ctx.args)
    return [given] if isinstance(given, str) else list(given)


def _beginning(incomplete: str, names: Iterable[str]) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]
