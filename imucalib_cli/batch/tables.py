"""Records as tables: CSV, markdown for a summary of CI, JUnit XML, lines for a terminal.

Names of logs and IMUs may hold any characters: each form escapes those that have a meaning in it.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from imucalib_cli.layout import Table, csv_columns
from imucalib_cli.results.fields import reasons
from imucalib_cli.shown import as_html, printable, readable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from imucalib_cli.batch.record import Record
    from imucalib_cli.layout import Block
    from imucalib_cli.results.result import Result

_LONGEST_SUMMARY = 1_000_000
"""Bytes of markdown: GitHub takes 1 MiB as the summary of a step."""
_FROM_WORST = ("failed", "untrusted", "ok")


class Entry(NamedTuple):
    """An IMU of a log, or why there is none."""

    record: Record
    result: Result | None
    reasons: list[str]
    """Why there is no result, or why it should not be used; the most serious first."""

    @property
    def status(self) -> str:
        """One of _FROM_WORST."""
        return "failed" if self.result is None else self.result.status

    @property
    def imu(self) -> str:
        """Its frame; empty where there is no result."""
        return "" if self.result is None else self.result.child

    @property
    def why(self) -> str:
        """The reasons in one line."""
        return "; ".join(self.reasons)


def entries(records: Iterable[Record]) -> Iterator[Entry]:
    """An entry for each result of each log, then one for each error."""
    for record in records:
        yield from (Entry(record, result, reasons(result)) for result in record.results)
        yield from (Entry(record, None, [error]) for error in record.errors)


def _of(take: Callable[[Result], Any]) -> Callable[[Entry], Any]:
    """A column that is empty without a result."""
    return lambda entry: entry.result and take(entry.result)


COLUMNS: tuple[tuple[str, str, Callable[[Entry], Any]], ...] = (
    ("log", "the log, as it was named", lambda entry: entry.record.log),
    ("imu", "frame of the IMU; empty where there is no result", lambda entry: entry.imu),
    ("topic", "its topic", _of(lambda result: result.imu_topic)),
    ("parent", "link that carries it", _of(lambda result: result.parent)),
    ("status", "ok, untrusted, or failed: there is no result", lambda entry: entry.status),
    ("exit_code", "of `imucalib run` on the log", lambda entry: entry.record.exit_code),
    (
        "tx_m ty_m tz_m",
        "translation, m; empty where the motion did not determine it",
        _of(lambda result: result.transform.translation),
    ),
    ("qx qy qz qw", "rotation", _of(lambda result: result.transform.rotation_xyzw)),
    (
        "roll_rad pitch_rad yaw_rad",
        "the same as URDF has it, rad",
        _of(lambda result: result.transform.rotation_rpy),
    ),
    (
        "std_tx_mm std_ty_mm std_tz_mm",
        "1 sigma along the parent's axes, mm",
        _of(lambda result: result.std and result.std.translation_mm),
    ),
    (
        "std_rx_deg std_ry_deg std_rz_deg",
        "1 sigma about the parent's axes, deg",
        _of(lambda result: result.std and result.std.rotation_deg),
    ),
    (
        "time_offset_s",
        "IMU stamp - robot stamp of the same instant, s",
        _of(lambda result: result.time_offset.seconds),
    ),
    ("time_offset_std_s", "its 1 sigma", _of(lambda result: result.time_offset.std)),
    (
        "reasons",
        "why there is no result, or why it should not be used; by `; `",
        lambda entry: entry.why,
    ),
    ("seconds", "the log took, in a worker", lambda entry: entry.record.seconds),
    (
        "key",
        (
            "SHA-256 of the contents of log and URDF, the options and the version; empty where the "
            "log is done again the next time"
        ),
        lambda entry: entry.record.key,
    ),
)
"""Columns of summary.csv and ``--format csv``: names, meaning, value."""


def csv_table(records: Iterable[Record]) -> str:
    """A header, then a row for each IMU and each failure."""
    columns = {names: take for names, _, take in COLUMNS}
    return csv_columns(columns, ((entry,) for entry in entries(records)))


def json_line(record: Record) -> str:
    """A record in one line of JSON."""
    return msgspec.json.encode(record).decode() + "\n"


_HEADS = ("log", "IMU", "status", "translation mm", "1 sigma mm", "1 sigma deg", "why not")


def _row(entry: Entry) -> tuple[str, ...]:
    """The most important columns, for people."""
    log, result = entry.record.log, entry.result
    if result is None:
        return (log, "", entry.status, "", "", "", entry.why)
    place = " ".join(
        "?" if value is None else f"{value * 1e3:.2f}" for value in result.transform.translation
    )
    parts: list[list[float | None]] = [[None], [None]]
    if result.std is not None:
        parts = [result.std.translation_mm, result.std.rotation_deg]
    largest = [
        "" if None in each else f"{max(filter(None, each), default=0.0):.2g}" for each in parts
    ]
    return (log, entry.imu, entry.status, place, *largest, entry.why)


def counted(records: Sequence[Record]) -> str:
    """The number of logs, and of each status, in words."""
    counts = dict.fromkeys(reversed(_FROM_WORST), 0)
    for record in records:
        counts[record.status] += 1
    listed = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
    return f"{len(records)} log{'s' * (len(records) != 1)}: {listed or 'none done'}"


def words(records: Sequence[Record]) -> tuple[Block, ...]:
    """For people: the number of logs of each status, and a table."""
    rows = tuple(map(_row, entries(records)))
    return counted(records), Table(_HEADS, rows, frozenset(_HEADS[4:6]))


def markdown(records: Sequence[Record]) -> str:
    """A table for GitHub and GitLab, the worst first, cut off at the limit of a summary."""
    worst_first = sorted(entries(records), key=lambda entry: _FROM_WORST.index(entry.status))
    lines = [f"**{counted(records)}**", "", _piped(_HEADS), _piped(["---"] * len(_HEADS))]
    size = 0
    for number, entry in enumerate(worst_first):
        line = _piped(map(_marked_down, _row(entry)))
        size += len(line.encode())
        if size > _LONGEST_SUMMARY:
            lines += ["", f"and {len(worst_first) - number} more"]
            break
        lines.append(line)
    return "\n".join([*lines, ""])


def _piped(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _marked_down(text: str) -> str:
    """Text with all characters of markdown escaped."""
    return as_html(re.sub(r"([\\`*_{}\[\]()#+!|~])", r"\\\1", text))


def junit(records: Sequence[Record]) -> str:
    """JUnit XML: a test for each IMU; untrusted is a failure, no result an error."""
    from xml.etree import ElementTree as ET

    suite = ET.Element("testsuite", name="imucalib batch")
    counts = dict.fromkeys(_FROM_WORST, 0)
    for entry in entries(records):
        record, status, why = entry.record, entry.status, printable(entry.why)
        counts[status] += 1
        case = ET.SubElement(
            suite,
            "testcase",
            classname=printable(record.log),
            name=printable(entry.imu) or "no result",
            time=f"{record.seconds / (len(record.results) + len(record.errors)):.3f}",
        )
        if status != "ok":
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
    """Problems of a log, for people: a word, and a sentence that names the log."""
    for entry in entries([record]):
        for reason in entry.reasons:
            if entry.result is not None:
                yield "untrusted", f"{record.log}: {entry.imu}: {reason}"
            elif reason.startswith(record.log):
                yield "error", reason
            else:
                yield "error", f"{record.log}: {reason}"


def github_lines(record: Record) -> list[str]:
    """Lines that GitHub Actions shows beside the files of a run: errors and warnings."""
    lines = []
    for entry in entries([record]):
        if entry.status != "ok":
            level = "error" if entry.status == "failed" else "warning"
            title = f"{entry.imu}: untrusted" if entry.imu else "no result"
            properties = f"file={_property(record.log)},title={_property(readable(title))}"
            lines.append(f"::{level} {properties}::{_data(readable(entry.why))}")
    return lines


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")


TABLES: dict[str, Callable[[Sequence[Record]], str]] = {
    "jsonl": lambda records: "".join(map(json_line, records)),
    "csv": csv_table,
    "markdown": markdown,
    "junit": junit,
}
"""Forms of ``--format``, beside words for people."""
