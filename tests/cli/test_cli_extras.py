"""Files beside the result: opened again by others' readers and compared with the estimate."""

import csv
import json
import re
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from msgspec.structs import asdict, replace
from rosbags.highlevel import AnyReader

from imucalib_cli.cli.extras import EXTRAS, write_extras
from imucalib_cli.cli.options import ExtraFiles, flag_of
from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.estimate.details import WindowSeries
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.jobs.calibrate import Outcome, calibrate
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.logs.part import Part
from imucalib_cli.report.debug_mcap import frames_of, topics_of
from imucalib_cli.results.codec import read_results, to_yaml
from imucalib_cli.results.result import Result
from imucalib_cli.robot.rotations import matrix_from_quaternion
from tests.conftest import Imucalib
from tests.slow import slow_after

SAMPLES = Path(__file__).parents[2] / "sample_data"
ARM = (SAMPLES / "rihibot.mcap", "--urdf", SAMPLES / "rihibot.urdf")
QUICK = ("--to", "20", "--robot", "exact", "--sensor-model", "ideal")


@pytest.fixture(scope="module")
def arm() -> Outcome:
    log, _, urdf = ARM
    request = CalibrationRequest(
        logs=(log,),
        urdf=urdf,
        part=Part(end=20.0),
        estimator=MatchedOptions(robot="exact", sensor_model="ideal"),
        details=True,
    )
    return calibrate(request)


@pytest.fixture(scope="module")
def two(arm: Outcome) -> Outcome:
    """Two IMUs whose frames differ by a letter that a topic may not have."""
    (one,) = arm.calibrated
    other = replace(one, result=renamed(one.result, "imu-link"))
    return replace(arm, calibrated=(one, other))


def renamed(result: Result, child: str) -> Result:
    transform = msgspec.structs.replace(result.transform, child=child)
    return msgspec.structs.replace(result, transform=transform)


def windows_of(outcome: Outcome) -> WindowSeries:
    details = outcome.calibrated[0].estimate.details
    assert details is not None
    return details.windows


def write_all(outcome: Outcome, written: Sequence[Path] = (), /, **files: Path) -> list[Any]:
    """Write the files; returns the errors."""
    extras = ExtraFiles(**{**dict.fromkeys(EXTRAS), **files})
    return write_extras(extras, outcome, read=[], written=written, force=False)


def write(outcome: Outcome, **files: Path) -> None:
    assert write_all(outcome, **files) == []


@dataclass(frozen=True)
class Messages:
    """An MCAP, and its messages by topic."""

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


def test_csv_has_stamp_and_units_for_every_instant(arm: Outcome, tmp_path: Path) -> None:
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
    """Messages by topic, by the readers of rosbags and of the mcap library, which agree."""
    found: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([path]) as reader, path.open("rb") as file:
        both = zip(make_reader(file).iter_messages(), reader.messages(), strict=True)
        for (schema, channel, message), (connection, ns, raw) in both:
            assert schema is not None
            told = (channel.topic, schema.name, message.log_time, message.data)
            assert told == (connection.topic, connection.msgtype, ns, raw)
            data = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((ns, data))
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


def test_mcap_contains_measured_and_predicted_values(arm: Outcome, of_arm: Messages) -> None:
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
    with of_arm.path.open("rb") as file:
        (attachment,) = make_reader(file).iter_attachments()
    assert attachment.name == "result.yaml"
    assert read_results(attachment.data.decode(), "result.yaml") == [arm.results[0]]


def test_mcap_transforms_follow_the_estimate(
    arm: Outcome, of_arm: Messages, imucalib: Imucalib
) -> None:
    found, windows = of_arm.found, windows_of(arm)
    result = arm.results[0]
    chain = [each.child_frame_id for each in found["/tf"][0][1].transforms]
    assert chain[-1] == result.parent
    for row in (0, 100, -1):
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
    out = imucalib("inspect", of_arm.path).out
    assert "/imucalib/imu_link/measured" in out
    assert "imu_link_nominal in wrist_3_link (static)" in out


def moved(outcome: Outcome, origin_ns: int) -> Outcome:
    """The same log by another clock."""
    sources = outcome.recording.sources
    sources = replace(sources, clock=replace(sources.clock, origin_ns=origin_ns))
    return replace(outcome, recording=replace(outcome.recording, sources=sources))


def test_mcap_may_begin_at_zero_and_must_end_before_2038(arm: Outcome, tmp_path: Path) -> None:
    windows = windows_of(arm)
    found = written(moved(arm, -round(1e9 * windows.t[0])), tmp_path).found
    assert found["/imucalib/imu_link/measured"][0][0] == 0
    offset = arm.results[0].time_offset.seconds
    early = int((windows.t - windows.t[0] < offset).sum())
    assert early > 0  # the robot's stamps of these windows are before 0
    assert len(found["/tf"]) == len(windows.t) - early
    late = moved(arm, 2**31 * 1_000_000_000)
    (failure,) = write_all(late, debug_mcap=tmp_path / "late.mcap")
    assert isinstance(failure, InputError)
    assert "after 2038" in str(failure)
    assert not (tmp_path / "late.mcap").exists()


def test_joints_move_with_the_base(arm: Outcome) -> None:
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
    # without joint states the log's frames have moved it, which the URDF's joints do not determine
    (alone,) = frames_of(result, driven, robot, (), t)
    assert (alone.parent, alone.child) == ("map", result.parent)


def test_body_without_urdf_follows_its_poses(tmp_path: Path) -> None:
    request = CalibrationRequest(
        logs=(SAMPLES / "barbot.bag",),
        parent="bar_link",
        estimator=MatchedOptions(gravity="none"),
        part=Part(end=15.0),
        details=True,
    )
    bar = calibrate(request)
    found, windows = written(bar, tmp_path).found, windows_of(bar)
    (stamped,) = found["/tf"][100][1].transforms
    assert stamped.header.frame_id == bar.results[0].provenance.world
    assert stamped.child_frame_id == "bar_link"
    assert transform(stamped)[:3, 3] == pytest.approx(windows.p_world_parent[100])
    assert "/robot_description" not in found
    layout = json.loads((tmp_path / "out.foxglove.json").read_text())
    assert "urdf" not in layout["configById"]["3D!robot"]["layers"]


@pytest.mark.parametrize(
    ("child", "topic"),
    [("imu_link", "imu_link"), ("/front/imu__0", "front_imu_0"), ("3dm", "imu_3dm"), ("!", "_")],
)
def test_topics_are_valid_ros_names(arm: Outcome, child: str, topic: str) -> None:
    assert topics_of([renamed(arm.results[0], child)]) == [f"/imucalib/{topic}"]


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


def test_layout_refers_to_existing_topics_and_fields(of_two: Messages) -> None:
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


def test_each_imu_has_its_own_files_and_topics(
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


@pytest.fixture(scope="module")
def few(arm: Outcome) -> Outcome:
    """One instant in twenty, which is soon drawn."""
    (one,) = arm.calibrated
    details = one.estimate.details
    assert details is not None
    columns = asdict(details.windows).items()
    windows = replace(details.windows, **{name: each[::20] for name, each in columns})
    rare = replace(details)
    vars(rare)["windows"] = windows
    estimate = replace(one.estimate, details=rare)
    return replace(arm, calibrated=(replace(one, estimate=estimate),))


@pytest.fixture(scope="module")
def drawn(few: Outcome, tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("matplotlib")
    path = tmp_path_factory.mktemp("drawn") / "a.svg"
    write(few, plot=path)
    return path


@pytest.mark.parametrize("suffix", slow_after(1, ["svg", "pdf", "png"]))
def test_figure_is_reproducible(few: Outcome, drawn: Path, suffix: str) -> None:
    from imucalib_cli.report.paper_plot import draw_residuals

    windows, path = windows_of(few), drawn.with_suffix(f".{suffix}")
    if path != drawn:
        write(few, plot=path)
    content = path.read_bytes()
    assert content == draw_residuals(windows, f".{suffix}")
    if suffix == "svg":
        text = content.decode()
        assert re.search(r"<text[^>]*>acceleration x, m/s²</text>", text)
        assert {"measured", "predicted", "residual"} <= set(re.findall(r">(\w+)</text>", text))
        assert ">left out<" not in text
        weight = np.where(np.abs(windows.t - 10.0) < 2.0, 0.0, 1.0)
        assert b">left out<" in draw_residuals(replace(windows, weight=weight), ".svg")


@pytest.mark.parametrize(
    ("told", "module", "extra"),
    [("--residuals a.parquet", "pyarrow", "parquet"), ("--plot a.svg", "matplotlib", "plot")],
)
def test_missing_package_is_reported_before_the_run(
    told: str, module: str, extra: str, monkeypatch: pytest.MonkeyPatch, imucalib: Imucalib
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    option, name = told.split()
    said = imucalib("run", *ARM, option, name, code=1)
    assert said.err == (
        f"error: {option} needs {module}, which is not installed: pip install 'imucalib[{extra}]'\n"
    )


def test_unwritable_extra_does_not_stop_the_others(arm: Outcome, tmp_path: Path) -> None:
    files = {"debug_mcap": tmp_path / "out.mcap", "residuals": tmp_path / "out.csv"}
    # a result that was written before
    (failure,) = write_all(arm, [tmp_path / "out.foxglove.json"], **files)
    assert isinstance(failure, ChoiceError)
    assert "would be written twice" in str(failure)
    assert [each.name for each in tmp_path.iterdir()] == ["out.csv"]


def test_run_writes_all_extra_files(
    arm: Outcome, drawn: Path, tmp_path: Path, imucalib: Imucalib
) -> None:
    suffixes = {"report": "html", "residuals": "csv", "debug_mcap": "mcap", "plot": "svg"}
    files = {name: tmp_path / f"out.{suffix}" for name, suffix in suffixes.items()}
    result = tmp_path / "result.yaml"
    given = [part for name, file in files.items() for part in (flag_of(name), file)]
    # Over its own files, those of a run before.
    write(arm, **{name: file for name, file in files.items() if name != "plot"})
    shutil.copy(drawn, files["plot"])
    result.write_text(to_yaml(arm.results))
    times = {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
    err = imucalib("run", *ARM, *QUICK, "-o", result, *given).err
    for file in (*files.values(), tmp_path / "out.foxglove.json"):
        assert f"wrote: {file}\n" in err
        assert file.stat().st_size > 1000
    assert all(file.stat().st_mtime_ns > before for file, before in times.items())
