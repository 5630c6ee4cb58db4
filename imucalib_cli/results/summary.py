"""The fields of a result as text for someone at a terminal."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

from imucalib_cli.results.fields import Field, Section, sections
from imucalib_cli.shown import shown

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.results.result import Result

_GREEN, _RED, _RESET = "\x1b[32m", "\x1b[31m", "\x1b[0m"


def summarise(result: Result, *, colour: bool = False) -> str:
    """Some thirty lines about one IMU, the verdict perhaps in colour (ANSI codes)."""
    trusted = result.status == "ok"
    verdict = "ok" if trusted else "UNTRUSTED, do not use as it stands"
    if colour:
        verdict = f"{_GREEN if trusted else _RED}{verdict}{_RESET}"
    head = f"{shown(f'{result.child} in {result.parent}')}: {verdict}"
    return "\n".join((head, *(shown(line) for line in _lines(result)))) + "\n"


def _lines(result: Result) -> Iterator[str]:
    """The poses stand apart, each below its formula."""
    for number, (_, group) in enumerate(groupby(sections(result), lambda each: bool(each.formula))):
        if number:
            yield ""
        for section in group:
            yield from _section(section)


def _section(section: Section) -> Iterator[str]:
    indent = "  "
    if section.formula:
        yield f"{indent}{section.title}: {section.formula}"
        indent = "    "
    yield from (f"{indent}{_field(field)}" for field in section.fields)


def _field(field: Field) -> str:
    """Values in a column; sentences as they are."""
    if field.severity or not field.label:
        return str(field)
    return f"{field.label:<15} {field.text}"
