"""The answer of trend as lines and a table for people, and as CSV."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from imucalib_cli.digits import with_std
from imucalib_cli.layout import Table, csv_text
from imucalib_cli.results.fields import instant

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from imucalib_cli.layout import Block
    from imucalib_cli.results.trend.answer import TrendAnswer, TrendRecording

_HEADS = ("recorded", "result", "mount", "shift mm", "turn deg")
_AXES = "xyz"


def blocks(answers: Sequence[TrendAnswer]) -> Iterator[Block]:
    """Of every IMU the verdict, and each recording with its distance from the first mount."""
    for number, answer in enumerate(answers):
        if number:
            yield ""
        yield f"{answer.verdict}: {answer.reason}"
        if answer.recordings:
            yield ""
            yield Table(_HEADS, tuple(_rows(answer)), numbers=frozenset(_HEADS[3:]))
        for each in answer.left_out:
            yield f"  left out: {each.file}: {each.reason}"


def _rows(answer: TrendAnswer) -> Iterator[tuple[str, ...]]:
    paths = [Path(each.file) for each in answer.recordings]
    short = len({path.name for path in paths}) == len(paths)
    for path, each in zip(paths, answer.recordings, strict=True):
        yield (
            "" if each.start is None else instant(each.start),
            path.name if short else each.file,
            "odd" if each.odd else "drifts" if each.mount is None else str(each.mount),
            _size(each.shift_mm, each.std_mm),
            _size(each.turn_deg, each.std_deg),
        )


def _size(vector: Sequence[float], std: Sequence[float]) -> str:
    """Norm and the sigma along it; the largest of the axes where the vector is short."""
    norm = math.hypot(*vector)
    along = math.hypot(*(v * s for v, s in zip(vector, std, strict=True)))
    return with_std(norm, max(std) if norm <= max(std) else along / norm)


def as_csv(answers: Sequence[TrendAnswer]) -> str:
    """One row for each recording, with its pose; what is not known is empty."""
    rows = (_row(answer, each) for answer in answers for each in answer.recordings)
    return csv_text(_COLUMNS, rows)


def _row(answer: TrendAnswer, each: TrendRecording) -> tuple[object, ...]:
    """Of _COLUMNS."""
    before = {change.before: change for change in answer.changes}.get(each.file)
    return (
        answer.parent,
        answer.child,
        answer.imu,
        each.file,
        "" if each.start is None else each.start.isoformat().replace("+00:00", "Z"),
        each.duration,
        each.mount,
        int(each.odd),
        "" if before is None else before.evidence,
        *each.translation,
        *each.rotation_xyzw,
        *each.shift_mm,
        *each.turn_deg,
        *each.std_mm,
        *each.std_deg,
    )


_COLUMNS = (
    *("parent", "child", "imu", "file", "start", "duration_s", "mount", "odd", "change_evidence"),
    *(f"translation_{axis}_m" for axis in _AXES),
    *(f"rotation_q{axis}" for axis in (*_AXES, "w")),
    *(f"shift_{axis}_mm" for axis in _AXES),
    *(f"turn_{axis}_deg" for axis in _AXES),
    *(f"std_{axis}_mm" for axis in _AXES),
    *(f"std_{axis}_deg" for axis in _AXES),
)
