"""The answer of trend in words, as a table and as CSV."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from imucalib_cli.digits import with_std
from imucalib_cli.layout import Table, csv_columns
from imucalib_cli.results.fields import instant

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from imucalib_cli.layout import Block
    from imucalib_cli.results.comparison.answers import TrendAnswer, TrendRecording

_HEADS = ("recorded", "result", "mount", "shift mm ± 1 sigma", "turn deg ± 1 sigma")


def blocks(answers: Sequence[TrendAnswer]) -> Iterator[Block]:
    """For every IMU the verdict, and each recording with its distance from the first mount."""
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
    """Norm and the sigma along the vector; the largest sigma of an axis if it is short."""
    norm = math.hypot(*vector)
    along = math.hypot(*(v * s for v, s in zip(vector, std, strict=True)))
    return with_std(norm, max(std) if norm <= max(std) else along / norm)


def as_csv(answers: Sequence[TrendAnswer]) -> str:
    """One row for each recording, with its pose; unknown values are empty."""
    rows = ((answer, each) for answer in answers for each in answer.recordings)
    return csv_columns(_COLUMNS, rows)


def _evidence(answer: TrendAnswer, each: TrendRecording) -> float | str:
    return {change.before: change.evidence for change in answer.changes}.get(each.file, "")


_COLUMNS: dict[str, Callable[[TrendAnswer, TrendRecording], object]] = {
    "parent": lambda answer, _: answer.parent,
    "child": lambda answer, _: answer.child,
    "imu": lambda answer, _: answer.imu,
    "file": lambda _, each: each.file,
    "start": lambda _, each: each.start and each.start.isoformat().replace("+00:00", "Z"),
    "duration_s": lambda _, each: each.duration,
    "mount": lambda _, each: each.mount,
    "odd": lambda _, each: int(each.odd),
    "change_evidence": _evidence,
    "translation_x_m translation_y_m translation_z_m": lambda _, each: each.translation,
    "rotation_qx rotation_qy rotation_qz rotation_qw": lambda _, each: each.rotation_xyzw,
    "shift_x_mm shift_y_mm shift_z_mm": lambda _, each: each.shift_mm,
    "turn_x_deg turn_y_deg turn_z_deg": lambda _, each: each.turn_deg,
    "std_x_mm std_y_mm std_z_mm": lambda _, each: each.std_mm,
    "std_x_deg std_y_deg std_z_deg": lambda _, each: each.std_deg,
}
