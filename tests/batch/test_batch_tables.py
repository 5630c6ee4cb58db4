"""Tables of records: read back by other readers, whatever names hold."""

import csv
import inspect
import io
import json
import re
from typing import get_args
from xml.etree import ElementTree as ET

import jsonschema
import pytest
from msgspec import to_builtins

from imucalib_cli.batch.record import Record, schema_of_record
from imucalib_cli.batch.tables import (
    COLUMNS,
    TABLES,
    complaints,
    csv_table,
    github_lines,
    json_line,
    junit,
    markdown,
    words,
)
from imucalib_cli.cli.commands.batch import batch_command
from imucalib_cli.findings import TEXT, untrusted
from imucalib_cli.layout import csv_text, plain
from imucalib_cli.shown import printable
from tests.results.results_samples import UP, make_result

HOSTILE = 'a,"b"\nc|d <i>*&amp;*</i> %0A::error::x\x1b[2J\u202e\u0000é'
NAMED = printable(HOSTILE)
"""As it stands in tables whose readers take no zero byte."""


def record(log: str = "a.mcap", **changes: object) -> Record:
    given: dict[str, object] = {
        "log": log,
        "place": f"/{log}",
        "status": "ok",
        "exit_code": 0,
        "seconds": 1.5,
        "key": "0" * 64,
        "errors": [],
        "written": [],
        "results": [make_result()],
        "files": [],
    }
    return Record(**(given | changes))  # type: ignore[arg-type]


def bad(log: str = "b.mcap", why: str = "too short") -> Record:
    return record(log, status="failed", exit_code=1, errors=[why], results=[], key=None)


def doubtful(log: str = "c.mcap", why: str = "segments disagree", child: str = "imu") -> Record:
    result = make_result(child=child, findings=(untrusted(TEXT, text=why),))
    return record(log, status="untrusted", exit_code=3, results=[result])


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text, newline="")))


def test_csv_has_a_row_for_each_imu_and_each_failure() -> None:
    two = record(results=[make_result(child="left"), make_result(child="right")])
    partly = record(status="failed", errors=["/imu: too short"])
    rows = rows_of(csv_table([two, bad(), partly]))
    assert [(row["log"], row["imu"], row["status"]) for row in rows] == [
        ("a.mcap", "left", "ok"),
        ("a.mcap", "right", "ok"),
        ("b.mcap", "", "failed"),
        ("a.mcap", "imu_link", "ok"),
        ("a.mcap", "", "failed"),
    ]
    assert list(rows[0]) == [name for names, *_ in COLUMNS for name in names.split()]
    result = two.results[0]
    assert result.std is not None
    for names, values in {
        "tx_m ty_m tz_m": result.transform.translation,
        "qx qy qz qw": result.transform.rotation_xyzw,
        "std_tx_mm std_ty_mm std_tz_mm": result.std.translation_mm,
        "std_rx_deg std_ry_deg std_rz_deg": result.std.rotation_deg,
        "time_offset_s": [result.time_offset.seconds],
    }.items():
        assert [float(rows[0][name]) for name in names.split()] == values
    assert rows[2]["reasons"] == "too short"
    assert rows[2]["key"] == rows[2]["tx_m"] == ""
    assert rows[2]["exit_code"] == "1"


def test_csv_cells_are_not_formulas() -> None:
    """A spreadsheet would read such a beginning as a formula; a number stays a number."""
    for name in ("=1+1", "+1+1", "-1+1", "@SUM(1)"):
        (row,) = rows_of(csv_table([bad(name)]))
        assert row["log"] == f"'{name}"
    (row,) = rows_of(csv_text(["value"], [["-1.5e-3"]]).replace("\n", "\r\n"))
    assert float(row["value"]) == -1.5e-3


def test_csv_states_failure_reason_and_leaves_unknowns_empty() -> None:
    result = make_result(unobservable=(UP,))
    (row,) = rows_of(csv_table([record(status="untrusted", exit_code=3, results=[result])]))
    known = result.transform.translation
    assert [row[name] for name in ("tx_m", "ty_m", "tz_m")] == [
        "" if value is None else str(value) for value in known
    ]
    assert None in known
    assert row["reasons"]


def test_json_line_equals_the_record() -> None:
    line = json_line(doubtful())
    assert line.count("\n") == 1
    document = json.loads(line)
    assert document["log"] == "c.mcap"
    assert document["results"] == [to_builtins(doubtful().results[0])]
    assert document["schema"] == 1
    schema = json.loads(schema_of_record())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(document, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**document, "exit_code": 77}, schema)


@pytest.mark.parametrize("form", [*TABLES])
def test_hostile_names_are_escaped(form: str) -> None:
    records = [bad(HOSTILE, HOSTILE), doubtful(HOSTILE, HOSTILE, HOSTILE), record(HOSTILE)]
    text = TABLES[form](records)
    match form:
        case "jsonl":
            assert [json.loads(line)["log"] for line in text.splitlines()] == [HOSTILE] * 3
        case "csv":
            assert [row["log"] for row in rows_of(text)] == [NAMED] * 3
            assert [row["imu"] for row in rows_of(text)] == ["", NAMED, "imu_link"]
        case "junit":
            suite = ET.fromstring(text)
            names = {case.get("classname") for case in suite}
            assert len(names) == 1
            assert (names.pop() or "").startswith('a,"b"\\nc|d <i>*&amp;*</i> %0A::error::x\\x1b')
        case "markdown":
            table = [line for line in text.splitlines() if line.startswith("|")]
            assert len(table) == 2 + 3
            assert {len(re.findall(r"(?<!\\)\|", line)) for line in table} == {8}
            assert "<i>" not in text
            assert text.replace("\n", "").isprintable()


def test_text_output_contains_no_terminal_escapes() -> None:
    text = plain(words([bad(HOSTILE, HOSTILE), doubtful(HOSTILE, HOSTILE, HOSTILE)]))
    assert text.replace("\n", "").isprintable()
    assert text.splitlines()[0] == "2 logs: 1 untrusted, 1 failed"


def test_log_is_named_once_per_complaint() -> None:
    assert list(complaints(bad(why="b.mcap is empty"))) == [("error", "b.mcap is empty")]
    assert list(complaints(bad())) == [("error", "b.mcap: too short")]
    assert list(complaints(doubtful())) == [("untrusted", "c.mcap: imu: segments disagree")]
    assert list(complaints(record())) == []


def test_github_annotations_parse_back_to_original_text() -> None:
    """By its own rules: a command ends with its line, properties are decoded before they are used.

    github.com/actions/runner, src/Runner.Common/ActionCommand.cs.
    """
    (line,) = github_lines(doubtful(HOSTILE, HOSTILE, "x: y, z"))
    assert "\n" not in line
    match = re.fullmatch(r"::(\w+) ([^:]*?(?:::)?[^:]*?)::(.*)", line)
    assert match is not None
    assert match[1] == "warning"
    pairs = dict(pair.split("=", 1) for pair in match[2].split(","))
    codes = {"%0D": "\r", "%0A": "\n", "%3A": ":", "%2C": ",", "%25": "%"}
    read = {
        name: re.sub("%0D|%0A|%3A|%2C|%25", lambda code: codes[code[0]], value)
        for name, value in pairs.items()
    }
    assert read == {"file": HOSTILE, "title": "x: y, z: untrusted"}
    assert github_lines(bad())[0] == "::error file=b.mcap,title=no result::too short"
    assert github_lines(record()) == []


def test_endless_names_are_cut_in_lines_for_github() -> None:
    for each in (bad(why=1_000_000 * "x"), doubtful(child=1_000_000 * "x")):
        assert len("".join(github_lines(each))) < 20_000


def test_junit_counts_failures() -> None:
    suite = ET.fromstring(junit([record(), bad(), doubtful()]))
    counts = {name: suite.get(name) for name in ("tests", "failures", "errors", "time")}
    assert counts == {"tests": "3", "failures": "1", "errors": "1", "time": "4.500"}
    kinds = [[child.tag for child in case] for case in suite]
    assert kinds == [[], ["error"], ["failure"]]
    assert suite[2][0].get("message") == "segments disagree"


def test_markdown_lists_worst_first_and_is_limited() -> None:
    text = markdown([record(), doubtful(), bad()])
    assert text.startswith("**3 logs: 1 ok, 1 untrusted, 1 failed**\n\n| log |")
    assert [line.split(" | ")[2] for line in text.splitlines()[4:]] == ["failed", "untrusted", "ok"]
    many = markdown([bad(why="x" * 10_000)] * 200)
    assert len(many.encode()) < 1 << 20
    assert re.search(r"\nand \d+ more\n$", many)


def test_command_offers_every_table_format() -> None:
    annotation = inspect.signature(batch_command).parameters["fmt"].annotation
    (literal, _) = get_args(annotation)
    assert {*get_args(literal)} == {*TABLES, "summary"}
