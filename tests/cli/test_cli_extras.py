"""Files beside the result: opened again by others' readers and compared with the estimate."""

from __future__ import annotations

import csv
import json
import re
import sys
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from imucalib_cli.cli.extras import EXTRAS, write_extras
from imucalib_cli.cli.main import main
from imucalib_cli.cli.options import ExtraFiles, flag_of
from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.jobs.calibrate import Outcome, calibrate
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.logs.part import Part
from imucalib_cli.report.debug_mcap import frames_of, topics_of
from imucalib_cli.results.codec import read_results, to_yaml
from imucalib_cli.robot.rotations import matrix_from_quaternion
from tests.slow import slow_after

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.estimate.details import WindowSeries
    from tests.conftest import Imucalib, LogWriter

SAMPLES = Path(__file__).parents[2] / "sample_data"
ARM = (SAMPLES / "rihibot.mcap", "--urdf", SAMPLES / "rihibot.urdf")


@pytest.fixture(scope="module")
def arm() -> Outcome:
    urdf = SAMPLES / "rihibot.urdf"
    return calibrate(CalibrationRequest(logs=(SAMPLES / "rihibot.mcap",), urdf=urdf, details=True))


@pytest.fixture(scope="module")
def bar() -> Outcome:
    return calibrate(
        CalibrationRequest(
            logs=(SAMPLES / "barbot.bag",),
            parent="bar_link",
            estimator=MatchedOptions(gravity="none"),
            part=Part(end=15.0),
            details=True,
        )
    )


@pytest.fixture(scope="module")
def two(arm: Outcome) -> Outcome:
    """Two IMUs whose frames differ by what a topic may not hold."""
    (one,) = arm.calibrated
    transform = msgspec.structs.replace(one.result.transform, child="imu-link")
    other = replace(one, result=msgspec.structs.replace(one.result, transform=transform))
    return replace(arm, calibrated=(one, other))


def windows_of(outcome: Outcome) -> WindowSeries:
    details = outcome.calibrated[0].estimate.details
    assert details is not None
    return details.windows


def write(outcome: Outcome, *, written: Sequence[Path] = (), **files: Path) -> None:
    extras = ExtraFiles(**{**dict.fromkeys(EXTRAS), **files})
    for failure in write_extras(
        extras, outcome, read=[], written=written, force=False, quiet=False
    ):
        raise failure


@dataclass(frozen=True)
class Messages:
    """An MCAP that was written, and its messages by topic."""

    path: Path
    found: dict[str, list[tuple[int, Any]]]


def written(outcome: Outcome, folder: Path) -> Messages:
    path = folder / "out.mcap"
    write(outcome, debug_mcap=path)
    return Messages(path, decoded(path))


@pytest.fixture(scope="module")
def of_arm(arm: Outcome, tmp_path_factory: pytest.TempPathFactory) -> Messages:
    return written(arm, tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def of_two(two: Outcome, tmp_path_factory: pytest.TempPathFactory) -> Messages:
    return written(two, tmp_path_factory.mktemp("two"))


def test_every_option_has_a_maker() -> None:
    assert {each.name for each in fields(ExtraFiles)} == set(EXTRAS)


def test_a_csv_has_every_instant_with_its_stamp_and_units(arm: Outcome, tmp_path: Path) -> None:
    write(arm, residuals=tmp_path / "out.csv")
    with (tmp_path / "out.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    windows = windows_of(arm)
    assert list(rows[0])[:3] == ["time_s", "stamp_ns", "accel_x_measured_m_s2"]
    for name, values in (
        ("time_s", windows.t),
        ("accel_z_predicted_m_s2", windows.accel_predicted[:, 2]),
        ("gyro_y_residual_rad_s", windows.gyro_residual[:, 1]),
        ("weight", windows.weight),
    ):
        assert np.array([float(row[name]) for row in rows]) == pytest.approx(values, rel=1e-9)
    # of the log itself, whose stamps begin at its origin
    stamps = [int(row["stamp_ns"]) for row in rows]
    (imu,) = arm.recording.imus
    assert imu.header_ns[0] < stamps[0]
    assert stamps[-1] < imu.header_ns[-1]
    assert (np.array(stamps) - 1_700_000_000_000_000_000) / 1e9 == pytest.approx(windows.t)


def test_parquet_holds_the_same_table(arm: Outcome, tmp_path: Path) -> None:
    parquet: Any = pytest.importorskip("pyarrow.parquet")
    write(arm, residuals=tmp_path / "out.parquet")
    table = parquet.read_table(tmp_path / "out.parquet")
    windows = windows_of(arm)
    assert (table["gyro_x_measured_rad_s"].to_numpy() == windows.gyro_measured[:, 0]).all()
    assert str(table["stamp_ns"].type) == "int64"
    assert table.num_columns == 21


def decoded(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Messages by topic, by the reader of the mcap library, decoded by their own definitions."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    found: dict[str, list[tuple[int, Any]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            data = store.deserialize_cdr(message.data, schema.name)
            found.setdefault(channel.topic, []).append((message.log_time, data))
    return found


def vectors(messages: Sequence[tuple[int, Any]], field: str) -> Any:
    told = [getattr(message, field) for _, message in messages]
    return np.array([(each.x, each.y, each.z) for each in told])


def transform(stamped: Any) -> Any:
    """As a 4x4 matrix."""
    q, p = stamped.transform.rotation, stamped.transform.translation
    matrix = np.eye(4)
    matrix[:3, :3] = matrix_from_quaternion([q.x, q.y, q.z, q.w])
    matrix[:3, 3] = p.x, p.y, p.z
    return matrix


def test_an_mcap_holds_what_was_measured_and_predicted(arm: Outcome, of_arm: Messages) -> None:
    found, windows = of_arm.found, windows_of(arm)
    stamps = np.round(windows.t * 1e9).astype(np.int64) + arm.recording.clock.origin_ns
    for what in ("measured", "predicted", "residual"):
        messages = found[f"/imucalib/imu_link/{what}"]
        for sensor, field in (("accel", "linear_acceleration"), ("gyro", "angular_velocity")):
            assert (vectors(messages, field) == getattr(windows, f"{sensor}_{what}")).all()
        assert {message.header.frame_id for _, message in messages} == {"imu_link"}
        header = messages[3][1].header.stamp
        assert header.sec * 1_000_000_000 + header.nanosec == messages[3][0] == stamps[3]
    weights = [message.data.tolist() for _, message in found["/imucalib/imu_link/weight"]]
    assert weights == windows.weight[:, None].tolist()
    ((_, description),) = found["/robot_description"]
    assert description.data == (SAMPLES / "rihibot.urdf").read_text()


def test_the_robot_moves_as_the_estimate_has_it(arm: Outcome, of_arm: Messages) -> None:
    found, windows = of_arm.found, windows_of(arm)
    result = arm.results[0]
    chain = [each.child_frame_id for each in found["/tf"][0][1].transforms]
    assert chain[-1] == result.parent
    for row in (0, 500, -1):
        ns, message = found["/tf"][row]
        product = np.eye(4)
        for stamped in message.transforms:
            product = product @ transform(stamped)
        # the URDF's joints, whose errors the estimate takes off
        assert product[:3, 3] == pytest.approx(windows.p_world_parent[row], abs=1e-4)
        assert product[:3, :3] == pytest.approx(windows.R_world_parent[row], abs=1e-4)
        seconds = (ns - arm.recording.clock.origin_ns) / 1e9
        assert seconds == pytest.approx(windows.t[row] - result.time_offset.seconds)
    ((_, static),) = found["/tf_static"]
    mounts = {each.child_frame_id: each for each in static.transforms}
    assert mounts["imu_link"].header.frame_id == result.parent
    assert transform(mounts["imu_link"])[:3, 3] == pytest.approx(result.pose.t)
    assert result.nominal is not None
    assert transform(mounts["imu_link_nominal"])[:3, 3] == pytest.approx(
        result.nominal.t_parent_imu
    )
    assert "camera_link" in mounts


def moved(outcome: Outcome, origin_ns: int) -> Outcome:
    """The same log by another clock."""
    sources = outcome.recording.sources
    sources = replace(sources, clock=replace(sources.clock, origin_ns=origin_ns))
    return replace(outcome, recording=replace(outcome.recording, sources=sources))


def test_a_log_may_begin_at_zero(arm: Outcome, tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    windows = windows_of(arm)
    write(moved(arm, -round(1e9 * windows.t[0])), debug_mcap=path)
    found = decoded(path)
    assert found["/imucalib/imu_link/measured"][0][0] == 0
    offset = arm.results[0].time_offset.seconds
    early = int((windows.t - windows.t[0] < offset).sum())
    assert early > 0  # the robot's stamps of these windows are before 0
    assert len(found["/tf"]) == len(windows.t) - early


def test_stamps_that_no_message_can_hold_are_refused(arm: Outcome, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="after 2038"):
        write(moved(arm, 2**31 * 1_000_000_000), debug_mcap=tmp_path / "out.mcap")
    assert not list(tmp_path.iterdir())


def test_a_moving_base_carries_the_joints(arm: Outcome) -> None:
    (one,) = arm.calibrated
    robot, joints = arm.recording.robot, arm.recording.sources.joints
    assert robot is not None
    provenance = msgspec.structs.replace(one.result.provenance, world="map")
    result = msgspec.structs.replace(one.result, provenance=provenance)
    windows = windows_of(arm)
    turn, place = matrix_from_quaternion([0.1, -0.2, 0.3, 0.9]), np.array([1.0, -2.0, 0.5])
    driven = replace(
        windows,
        R_world_parent=turn @ windows.R_world_parent,
        p_world_parent=windows.p_world_parent @ turn.T + place,
    )
    t = windows.t - one.result.time_offset.seconds
    base, *links = frames_of(result, driven, robot, joints, t)
    assert (base.parent, base.child) == ("map", "base_link")
    assert np.abs(base.R - turn).max() < 1e-3
    assert np.abs(base.p - place).max() < 1e-3
    assert {link.child for link in links} == set(robot.links) - {robot.root}
    # without joint states the log's frames have moved it, which the URDF's joints cannot tell
    (alone,) = frames_of(result, driven, robot, (), t)
    assert (alone.parent, alone.child) == ("map", result.parent)


def test_a_body_without_a_urdf_moves_as_its_poses_do(bar: Outcome, tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    write(bar, debug_mcap=path)
    found, windows = decoded(path), windows_of(bar)
    (stamped,) = found["/tf"][100][1].transforms
    assert (stamped.header.frame_id, stamped.child_frame_id) == (
        bar.results[0].provenance.world,
        "bar_link",
    )
    assert transform(stamped)[:3, 3] == pytest.approx(windows.p_world_parent[100])
    assert "/robot_description" not in found
    layout = json.loads((tmp_path / "out.foxglove.json").read_text())
    assert "urdf" not in layout["configById"]["3D!robot"]["layers"]


def test_the_mcap_carries_the_result(arm: Outcome, of_arm: Messages) -> None:
    with of_arm.path.open("rb") as file:
        (attachment,) = make_reader(file).iter_attachments()
    assert attachment.name == "result.yaml"
    assert read_results(attachment.data.decode(), "result.yaml") == [arm.results[0]]


def test_rosbags_reads_the_same(of_arm: Messages) -> None:
    ours, seen = of_arm.found, 0
    with AnyReader([of_arm.path]) as reader:
        assert {connection.topic for connection in reader.connections} == set(ours)
        last = 0
        for connection, ns, raw in reader.messages():
            assert ns >= last
            last, seen = ns, seen + 1
            if connection.topic == "/imucalib/imu_link/predicted" and seen % 100 == 0:
                message: Any = reader.deserialize(raw, connection.msgtype)
                (same,) = (each for each_ns, each in ours[connection.topic] if each_ns == ns)
                assert message.linear_acceleration.z == same.linear_acceleration.z
    assert seen == sum(map(len, ours.values()))


def test_inspect_reads_the_mcap(of_arm: Messages, imucalib: Imucalib) -> None:
    out = imucalib("inspect", of_arm.path).out
    assert "/imucalib/imu_link/measured" in out
    assert "imu_link_nominal in wrist_3_link (static)" in out


@pytest.mark.parametrize(
    ("child", "topic"),
    [("imu_link", "imu_link"), ("/front/imu__0", "front_imu_0"), ("3dm", "imu_3dm"), ("!", "_")],
)
def test_topics_are_what_ros_allows(arm: Outcome, child: str, topic: str) -> None:
    (result,) = arm.results
    transform = msgspec.structs.replace(result.transform, child=child)
    assert topics_of([msgspec.structs.replace(result, transform=transform)]) == [
        f"/imucalib/{topic}"
    ]


def panels_of(layout: Any, panels: dict[str, Any]) -> set[str]:
    """Ids of the panels that a layout shows, tabs opened."""
    if isinstance(layout, dict):
        assert layout["direction"] in {"row", "column"}
        assert 0 < layout["splitPercentage"] < 100
        return panels_of(layout["first"], panels) | panels_of(layout["second"], panels)
    tabs = panels[layout].get("tabs", [])
    return {layout}.union(*(panels_of(tab["layout"], panels) for tab in tabs))


def value_at(message: Any, path: str) -> Any:
    for part in path.split("."):
        name, _, index = part.partition("[")
        message = getattr(message, name)
        message = message[int(index.rstrip("]"))] if index else message
    return message


def test_the_layout_shows_topics_and_fields_that_are_there(of_two: Messages) -> None:
    found = of_two.found
    layout = json.loads(of_two.path.with_name("out.foxglove.json").read_text())
    panels = layout["configById"]
    assert panels_of(layout["layout"], panels) == set(panels)
    shown = set()
    for panel in panels.values():
        for line in panel.get("paths", ()):
            topic, path = re.split(r"\.", line["value"], maxsplit=1)
            assert isinstance(value_at(found[topic][0][1], path), float)
            shown.add(topic)
    assert shown == {topic for topic in found if topic.startswith("/imucalib/")}
    assert panels["3D!robot"]["layers"]["urdf"]["topic"] in found
    assert [tab["title"] for tab in panels["Tab!imus"]["tabs"]] == ["imu_link", "imu-link"]


def test_each_of_several_imus_has_its_files_and_topics(
    two: Outcome, of_two: Messages, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(two, residuals=tmp_path / "out.csv", debug_mcap=tmp_path / "out.mcap")
    names = ["out.foxglove.json", "out.imu-link.csv", "out.imu_link.csv", "out.mcap"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    told = capsys.readouterr().err.splitlines()
    assert sorted(told) == [f"wrote: {tmp_path / name}" for name in names]
    found = of_two.found
    assert {"/imucalib/imu_link/weight", "/imucalib/imu_link_2/weight"} <= set(found)
    children = [each.child_frame_id for each in found["/tf_static"][0][1].transforms]
    assert {"imu_link", "imu-link", "imu_link_nominal", "imu-link_nominal"} < set(children)
    assert len(children) == len(set(children))


def test_the_files_of_several_imus_spare_inputs_and_outputs(
    two: Outcome, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ChoiceError, match="would be written twice"):
        write(two, residuals=tmp_path / "out.csv", written=[tmp_path / "out.imu_link.csv"])
    assert not list(tmp_path.iterdir())
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("suffix", slow_after(1, ["svg", "pdf", "png"]))
def test_a_figure_is_the_same_bytes_each_time(arm: Outcome, suffix: str, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    for name in ("a", "b"):
        write(arm, plot=tmp_path / f"{name}.{suffix}")
    content = (tmp_path / f"a.{suffix}").read_bytes()
    assert content == (tmp_path / f"b.{suffix}").read_bytes()
    if suffix == "svg":
        text = content.decode()
        assert re.search(r"<text[^>]*>acceleration x, m/s²</text>", text)
        assert {"measured", "predicted", "residual"} <= set(re.findall(r">(\w+)</text>", text))
        assert ">left out<" not in text


def test_what_was_left_out_is_shaded(arm: Outcome) -> None:
    pytest.importorskip("matplotlib")
    from imucalib_cli.report.paper_plot import draw_residuals

    windows = windows_of(arm)
    weight = np.where(np.abs(windows.t - 30.0) < 2.0, 0.0, 1.0)
    holed = replace(windows, weight=weight)
    assert b">left out<" in draw_residuals(holed, ".svg")


# The command line, before anything is computed.


def test_the_published_method_has_no_series(imucalib: Imucalib, tmp_path: Path) -> None:
    told = ["--method", "paper", "--residuals", tmp_path / "out.csv"]
    said = imucalib("run", *(*ARM, *told), code=2)
    assert said.err.startswith("error: --residuals belongs to --method matched")


@pytest.mark.parametrize(
    ("told", "module", "extra"),
    [("--residuals a.parquet", "pyarrow", "parquet"), ("--plot a.svg", "matplotlib", "plot")],
)
def test_what_is_not_installed_is_said_at_once(
    told: str, module: str, extra: str, monkeypatch: pytest.MonkeyPatch, imucalib: Imucalib
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    option, name = told.split()
    said = imucalib("run", *ARM, option, name, code=1)
    assert said.err == (
        f"error: {option} needs {module}, which is not installed: pip install 'imucalib[{extra}]'\n"
    )


@pytest.mark.parametrize(
    ("option", "name", "words"),
    [
        ("--residuals", "out.txt", "expected a file ending in .csv or .parquet"),
        ("--debug-mcap", "-", "expected a file ending in .mcap"),
        ("--plot", "", "is empty"),
    ],
)
def test_the_suffix_says_the_form(option: str, name: str, words: str, imucalib: Imucalib) -> None:
    err = imucalib("run", *ARM, option, name, code=2).err
    assert option in err
    assert words in err


def test_no_input_and_no_other_output_is_written_over(
    log_writer: LogWriter, arm_urdf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = log_writer.imu().joints().write()
    before = log.read_bytes()
    run = ["run", str(log), "--urdf", str(arm_urdf)]
    for files, words in (
        (["--debug-mcap", log], "is an input and would be overwritten"),
        (["--debug-mcap", SAMPLES / "rihibot.mcap"], "is a log and would be overwritten"),
        (["-o", tmp_path / "a.csv", "--residuals", tmp_path / "a.csv"], "would be written twice"),
        (
            ["-o", tmp_path / "a.foxglove.json", "--debug-mcap", tmp_path / "a.mcap"],
            "would be written twice",
        ),
        (["--plot", tmp_path / "nowhere" / "a.svg"], "there is no folder"),
    ):
        assert main([*run, *map(str, files)]) in {1, 2}
        assert words in capsys.readouterr().err
    assert log.read_bytes() == before


def test_one_that_cannot_be_written_stops_no_other(arm: Outcome, tmp_path: Path) -> None:
    taken = tmp_path / "out.foxglove.json"  # a result that was written before
    files = {"debug_mcap": tmp_path / "out.mcap", "residuals": tmp_path / "out.csv"}
    extras = ExtraFiles(**{**dict.fromkeys(EXTRAS), **files})
    (failure,) = write_extras(extras, arm, read=[], written=[taken], force=False, quiet=True)
    assert "would be written twice" in str(failure)
    assert [each.name for each in tmp_path.iterdir()] == ["out.csv"]


def test_a_run_writes_all_of_them(arm: Outcome, tmp_path: Path, imucalib: Imucalib) -> None:
    suffixes = {"report": "html", "residuals": "csv", "debug_mcap": "mcap", "plot": "svg"}
    files = {name: tmp_path / f"out.{suffix}" for name, suffix in suffixes.items()}
    result = tmp_path / "result.yaml"
    given = [part for name, file in files.items() for part in (flag_of(name), file)]
    # Over its own files, those of a run before.
    write(arm, written=(), **files)
    result.write_text(to_yaml(arm.results))
    times = {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
    err = imucalib("run", *ARM, "-o", result, *given).err
    for file in (*files.values(), tmp_path / "out.foxglove.json"):
        assert f"wrote: {file}\n" in err
        assert file.stat().st_size > 1000
    assert all(file.stat().st_mtime_ns > before for file, before in times.items())
