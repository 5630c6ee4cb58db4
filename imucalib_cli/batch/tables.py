"""Records as tables: CSV, markdown for a summary of CI, JUnit XML, lines for a terminal.

Names in a log, and of one, may hold anything: each form escapes what has a meaning in it.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from imucalib_cli.batch.record import by_imu
from imucalib_cli.layout import Table, csv_text
from imucalib_cli.results.fields import unobservable_fields
from imucalib_cli.shown import as_html, shown

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from imucalib_cli.batch.record import Record
    from imucalib_cli.layout import Block
    from imucalib_cli.results.result import Result

    Cell = str | int | float | None
    Entry = Result | str
    """Of an IMU, or why there is none."""

_LONGEST_SUMMARY = 1_000_000
"""Bytes of markdown: GitHub takes 1 MiB as the summary of a step."""
_BETWEEN = "; "


class Column(NamedTuple):
    """A column of the CSV table."""

    meaning: str
    of_log: Callable[[Record], Cell] | None = None
    of_result: Callable[[Result], Cell] | None = None
    of_failure: Callable[[str], Cell] = lambda _: None


def reasons(entry: Entry) -> list[str]:
    """Why there is no result, or why it should not be used; the gravest first."""
    if isinstance(entry, str):
        return [entry]
    return [*entry.diagnostics.distrust, *map(str, unobservable_fields(entry))]


def _vector(
    names: Sequence[str], what: str, values: Callable[[Result], Sequence[float | None] | None]
) -> dict[str, Column]:
    """A column for each component of a vector, empty where it is not known."""

    def component(place: int) -> Callable[[Result], Cell]:
        return lambda result: (values(result) or [None] * len(names))[place]

    return {name: Column(what, of_result=component(place)) for place, name in enumerate(names)}


COLUMNS: dict[str, Column] = {
    "log": Column("the log, as it was named", lambda record: record.log),
    "imu": Column("frame of the IMU; empty where there is no result", None, lambda r: r.child),
    "topic": Column("its topic", None, lambda result: result.imu_topic),
    "parent": Column("link that carries it", None, lambda result: result.parent),
    "status": Column(
        "ok, untrusted, or failed: there is no result",
        None,
        lambda result: result.status,
        lambda _: "failed",
    ),
    "exit_code": Column("of `imucalib run` on the log", lambda record: record.exit_code),
    **_vector(
        ("tx_m", "ty_m", "tz_m"),
        "translation, m; empty where the motion did not determine it",
        lambda result: result.transform.translation,
    ),
    **_vector(("qx", "qy", "qz", "qw"), "rotation", lambda result: result.transform.rotation_xyzw),
    **_vector(
        ("roll_rad", "pitch_rad", "yaw_rad"),
        "the same as URDF has it, rad",
        lambda result: result.transform.rotation_rpy,
    ),
    **_vector(
        ("std_tx_mm", "std_ty_mm", "std_tz_mm"),
        "1 sigma along the parent's axes, mm",
        lambda result: None if result.std is None else result.std.translation_mm,
    ),
    **_vector(
        ("std_rx_deg", "std_ry_deg", "std_rz_deg"),
        "1 sigma about the parent's axes, deg",
        lambda result: None if result.std is None else result.std.rotation_deg,
    ),
    "time_offset_s": Column(
        "IMU stamp - robot stamp of the same instant, s", None, lambda r: r.time_offset.seconds
    ),
    "time_offset_std_s": Column("its 1 sigma", None, lambda result: result.time_offset.std),
    "reasons": Column(
        "why there is no result, or why it should not be used; by `; `",
        None,
        lambda result: _BETWEEN.join(reasons(result)),
        lambda failure: failure,
    ),
    "seconds": Column("the log took, in a worker", lambda record: record.seconds),
    "key": Column(
        "SHA-256 of the contents of log and URDF, the options and the version; empty where the "
        "log is done again the next time",
        lambda record: record.key,
    ),
}
"""Of summary.csv and ``--format csv``, in their order: a row for each IMU, and for each failure."""


def csv_table(records: Iterable[Record]) -> str:
    """A header, then a row for each IMU and each failure."""
    return csv_text(
        COLUMNS,
        (
            [_value(column, record, entry) for column in COLUMNS.values()]
            for record in records
            for entry in by_imu(record)
        ),
    )


def _value(column: Column, record: Record, entry: Entry) -> Cell:
    if column.of_log is not None:
        return column.of_log(record)
    if isinstance(entry, str):
        return column.of_failure(entry)
    return None if column.of_result is None else column.of_result(entry)


def json_line(record: Record) -> str:
    """A record in one line of JSON."""
    return msgspec.json.encode(record).decode() + "\n"


def json_lines(records: Iterable[Record]) -> str:
    """A line for each record."""
    return "".join(map(json_line, records))


_HEADS = ("log", "IMU", "status", "translation mm", "± mm", "± deg", "why not")


def _row(record: Record, entry: Entry) -> tuple[str, ...]:
    """What a person looks at first."""
    why = _BETWEEN.join(reasons(entry))
    if isinstance(entry, str):
        return (record.log, "", "failed", "", "", "", why)
    place = " ".join(
        "?" if value is None else f"{value * 1e3:.2f}" for value in entry.transform.translation
    )
    std = entry.std
    sigmas = [] if std is None else [std.translation_mm, std.rotation_deg]
    largest = [
        "" if None in each else f"{max(filter(None, each), default=0.0):.2g}" for each in sigmas
    ]
    return (record.log, entry.child, entry.status, place, *(largest or ["", ""]), why)


def counted(records: Sequence[Record]) -> str:
    """How many logs are what, in words."""
    counts = dict.fromkeys(reversed(_FROM_WORST), 0)
    for record in records:
        counts[record.status] += 1
    told = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
    return f"{len(records)} log{'s' * (len(records) != 1)}: {told or 'none done'}"


def words(records: Sequence[Record]) -> tuple[Block, ...]:
    """For people: how many logs are what, and a table of them."""
    rows = tuple(_row(record, entry) for record in records for entry in by_imu(record))
    return counted(records), Table(_HEADS, rows, frozenset(_HEADS[4:6]))


def markdown(records: Sequence[Record]) -> str:
    """A table as GitHub and GitLab show it; the worst first, as far as a summary may be long."""
    rows = [
        (entry_status(entry), _row(record, entry)) for record in records for entry in by_imu(record)
    ]
    rows.sort(key=lambda row: _FROM_WORST.index(row[0]))
    lines = [f"**{counted(records)}**", "", _piped(_HEADS), _piped(["---"] * len(_HEADS))]
    size = 0
    for number, (_, row) in enumerate(rows):
        line = _piped([_marked_down(cell) for cell in row])
        size += len(line.encode())
        if size > _LONGEST_SUMMARY:
            lines += ["", f"and {len(rows) - number} more"]
            break
        lines.append(line)
    return "\n".join([*lines, ""])


_FROM_WORST = ("failed", "untrusted", "ok")


def entry_status(entry: Entry) -> str:
    """ok, untrusted or failed."""
    return "failed" if isinstance(entry, str) else entry.status


def _piped(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _marked_down(text: str) -> str:
    """Text that is nothing but text to markdown."""
    return as_html(re.sub(r"([\\`*_{}\[\]()#+!|~])", r"\\\1", text))


def junit(records: Sequence[Record]) -> str:
    """JUnit XML: a test for each IMU; untrusted is a failure, no result an error."""
    from xml.etree import ElementTree as ET

    suite = ET.Element("testsuite", name="imucalib batch")
    counts = dict.fromkeys(_FROM_WORST, 0)
    for record in records:
        entries = list(by_imu(record))
        for entry in entries:
            status = entry_status(entry)
            counts[status] += 1
            case = ET.SubElement(
                suite,
                "testcase",
                classname=shown(record.log),
                name="no result" if isinstance(entry, str) else shown(entry.child),
                time=f"{record.seconds / len(entries):.3f}",
            )
            if status != "ok":
                why = shown(_BETWEEN.join(reasons(entry)))
                kind = "error" if status == "failed" else "failure"
                ET.SubElement(case, kind, message=why, type=status).text = why
    suite.attrib |= {
        "tests": str(sum(counts.values())),
        "failures": str(counts["untrusted"]),
        "errors": str(counts["failed"]),
        "time": f"{sum(record.seconds for record in records):.3f}",
    }
    ET.indent(suite)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{ET.tostring(suite, encoding="unicode")}\n'


def complaints(record: Record) -> Iterator[tuple[str, str]]:
    """What is wrong with a log, for people: a word, and a sentence that names it."""
    for entry in by_imu(record):
        if isinstance(entry, str):
            yield "error", entry if entry.startswith(record.log) else f"{record.log}: {entry}"
        else:
            for reason in reasons(entry):
                yield "untrusted", f"{record.log}: {entry.child}: {reason}"


def github_lines(record: Record) -> list[str]:
    """Lines that GitHub Actions shows beside the files of a run: errors and warnings."""
    lines = []
    for entry in by_imu(record):
        status = entry_status(entry)
        if status == "ok":
            continue
        level = "error" if status == "failed" else "warning"
        title = "no result" if isinstance(entry, str) else f"{entry.child}: untrusted"
        properties = f"file={_property(record.log)},title={_property(title)}"
        lines.append(f"::{level} {properties}::{_data(shown(_BETWEEN.join(reasons(entry))))}")
    return lines


def _data(text: str) -> str:
    """As the commands of GitHub's workflows have it."""
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")


TABLES: dict[str, Callable[[Sequence[Record]], str]] = {
    "jsonl": json_lines,
    "csv": csv_table,
    "markdown": markdown,
    "junit": junit,
}
"""Forms of ``--format``, beside words for people."""
