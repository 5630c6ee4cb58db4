"""Every storage and compression against rosbags, message by message, bit for bit."""

import importlib
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from imucalib_cli.findings import warnings
from imucalib_cli.logs.decoding import decode, wire
from imucalib_cli.logs.log import LogData, open_log
from tests.logs.logs_samples import (
    START_NS,
    Said,
    T,
    Write,
    imu,
    joints,
    mixed_messages,
    one_file,
    read_all,
    said_on,
    say,
    write_log,
)

DESCRIBED = "<robot>\n\t<!-- ° -->\n</robot>"
"""A text, which is read once although it is said twice."""
Rows = dict[tuple[str, ...], list[tuple[Any, ...]]]


@pytest.fixture(scope="module")
def messages() -> list[Said]:
    """Fewer than elsewhere, because every storage is written and read for every test."""
    said = mixed_messages(100)
    texts = zip((DESCRIBED, "", DESCRIBED), said, strict=False)
    described = (
        say("/robot_description", T["String"](data=text), each.log_ns) for text, each in texts
    )
    return [*described, *said]


def _ns(stamped: Any) -> int:
    return int(stamped.header.stamp.sec * 10**9 + stamped.header.stamp.nanosec)


def _xyz(vector: Any) -> tuple[float, ...]:
    return vector.x, vector.y, vector.z


def _pose(position: Any, orientation: Any) -> tuple[float, ...]:
    return *_xyz(position), *_xyz(orientation), orientation.w


def expected_rows(messages: Iterable[tuple[str, str, Any, int]]) -> Rows:
    """Rows of each stream, from deserialised messages, with plain attribute access."""
    rows: Rows = {}
    order: dict[frozenset[str], list[str]] = {}
    for topic, type_name, message, log_ns in messages:
        match type_name.rsplit("/", 1)[-1]:
            case "Imu":
                gyro, accel = message.angular_velocity, message.linear_acceleration
                row = (log_ns, _ns(message), *_xyz(gyro), *_xyz(accel))
                rows.setdefault((topic,), []).append(row)
            case "JointState":
                names = order.setdefault(frozenset(message.name), list(message.name))
                values = dict(zip(message.name, message.position, strict=True))
                row = (log_ns, _ns(message), *(values[name] for name in names))
                rows.setdefault((topic, *names), []).append(row)
            case "TFMessage":
                for each in message.transforms:
                    pose = _pose(each.transform.translation, each.transform.rotation)
                    key = (topic, each.header.frame_id, each.child_frame_id)
                    rows.setdefault(key, []).append((log_ns, _ns(each), *pose))
            case "TransformStamped":
                pose = _pose(message.transform.translation, message.transform.rotation)
                key = (topic, message.header.frame_id, message.child_frame_id)
                rows.setdefault(key, []).append((log_ns, _ns(message), *pose))
            case "PoseStamped" | "PoseWithCovarianceStamped" | "Odometry":
                inner = message.pose if hasattr(message.pose, "position") else message.pose.pose
                pose = _pose(inner.position, inner.orientation)
                key = (topic, message.header.frame_id, getattr(message, "child_frame_id", ""))
                rows.setdefault(key, []).append((log_ns, _ns(message), *pose))
    return rows


def read_rows(data: LogData) -> dict[tuple[str, ...], np.ndarray[Any, Any]]:
    """The streams as read, in the same form; integers beside floats, hence object arrays."""
    found: dict[tuple[str, ...], list[Any]] = {}
    for topic, each in data.imus.items():
        found[(topic,)] = [each, each.gyro, each.accel]
    for topic, streams in data.joints.items():
        found |= {(topic, *joint.names): [joint, joint.position] for joint in streams}
    for topic, poses in data.poses.items():
        for pose in poses:
            key = (topic, pose.parent, pose.child)
            found[key] = [pose, pose.position, pose.quaternion_xyzw]
    return {
        key: np.column_stack(
            [np.asarray(x, object) for x in (each.log_ns, each.header_ns, *values)]
        )
        for key, (each, *values) in found.items()
    }


def assert_same(data: LogData, rows: Rows) -> None:
    found = read_rows(data)
    assert found.keys() == rows.keys()
    for key, expected in rows.items():
        table = np.array(expected, dtype=object)
        if table.shape[1] == 9 and len(key) == 3:  # poses: ours are normalised
            quaternion = table[:, 5:].astype(float)
            table[:, 5:] = quaternion / np.linalg.norm(quaternion, axis=1)[:, None]
        np.testing.assert_array_equal(found[key], table, err_msg=str(key))


def rows_of_messages(messages: list[Said]) -> Rows:
    return expected_rows((each.topic, each.type, each.message, each.log_ns) for each in messages)


def test_every_storage_reads_like_rosbags(
    messages: list[Said], storage: str, written: Write
) -> None:
    name = "log.bag" if storage.startswith("bag") else "log.mcap"
    path = written(messages, storage, name=name)
    rows = rows_of_messages(messages)
    if storage != "mcap-ros1":  # which rosbags refuses
        with AnyReader([path]) as reader:
            rows = expected_rows(
                (each.topic, each.msgtype, reader.deserialize(raw, each.msgtype), log_ns)
                for each, log_ns, raw in reader.messages()
            )
    log = open_log([path])
    told: list[float] = []
    data = log.read([topic.name for topic in log.topics if topic.kinds], told.append)
    assert told == sorted(told)
    assert told[0] < told[-1] == 1
    assert warnings(data.findings) == ()
    assert_same(data, rows)
    topics = {topic.name: topic for topic in log.topics}
    assert len(topics) == 10
    for name, topic in topics.items():
        of_topic = [each for each in messages if each.topic == name]
        assert topic.count == len(of_topic)
        assert topic.type == of_topic[0].type.replace("/msg/", "/")
        assert (topic.start_ns, topic.end_ns) == (of_topic[0].log_ns, of_topic[-1].log_ns)
    assert [*topics["/chatter"].kinds] == ["text"]
    assert data.texts["/robot_description"] == (DESCRIBED, "")
    assert data.poses["/tf_static"][0].is_static
    assert data.imus["/imu"].frame_id == "imu_link"


def test_slow_route_agrees_with_bulk_route(
    messages: list[Said], written: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    for storage in ("bag-none", "mcap-none", "mcap-ros1"):
        path = written(messages, storage, name=storage)
        with monkeypatch.context() as patch:
            patch.setattr(decode, "decode_one", pytest.fail)
            bulk = read_rows(read_all(path))
        with monkeypatch.context() as patch:
            patch.setattr(wire, "MAX_SHAPES", 0)
            slow = read_rows(read_all(path))
        assert bulk.keys() == slow.keys()
        for key, table in bulk.items():
            np.testing.assert_array_equal(table, slow[key])


def test_large_messages_among_wanted_ones_are_handled(storage: str, written: Write) -> None:
    """Images are jumped over where they lie unpacked; messages may exceed what is read ahead."""
    rng = np.random.default_rng(3)
    names = [f"joint_{k}" for k in range(400)]
    said = []
    for k in range(20):
        ns = START_NS + k * 10_000_000
        said += [
            say("/imu", imu(ns, rng), ns),
            say("/text", T["String"](data="y" * 70_000), ns + 1),
            say("/joints", joints(ns, rng, names[k % 2 :]), ns + 2),
            say("/text", T["String"](data="z" * (10 + k)), ns + 3),
        ]
    path = written(said, storage, chunk_bytes=500_000)
    assert_same(read_all(path), rows_of_messages(said))
    only = open_log([path]).read(["/imu"])
    assert len(only.imus["/imu"]) == 20
    assert only.joints == {}
    assert warnings(only.findings) == ()


@pytest.mark.parametrize("storage", ["mcap-zstd", "bag-lz4"])
def test_chunks_without_wanted_topics_are_not_decompressed(
    messages: list[Said], storage: str, written: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(messages, storage, chunk_bytes=1000)
    log = open_log([path])
    unpacked = []

    inflate = importlib.import_module("imucalib_cli.logs.chunked.inflate").inflate

    def counting(*arguments: Any) -> Any:
        unpacked.append(1)
        return inflate(*arguments)

    monkeypatch.setattr("imucalib_cli.logs.chunked.chunks.inflate", counting)
    log.read(["/tf_static"])
    assert len(unpacked) == 1
    unpacked.clear()
    log.read(["/imu"])
    assert 10 < len(unpacked) <= 300


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (("mcap-lz4", "split_0.mcap"), ("mcap-zstd", "split_1.mcap")),
        (("bag-bz2", "first"), ("mcap-none", "second")),
        (("bag-lz4", "a.mcap"), ("mcap-zstd", "b.bag")),
    ],
)
def test_files_of_one_recording_are_joined_in_any_storage(
    first: tuple[str, str], second: tuple[str, str], messages: list[Said], written: Write
) -> None:
    half = len(messages) // 2
    parts = [written(messages[half:], *second), written(messages[:half], *first)]
    data = read_all(*parts)
    assert_same(data, rows_of_messages(messages))
    assert warnings(data.findings) == ()
    if parts[0].name == "split_1.mcap":  # by their numbers, those of a folder are one recording
        assert_same(read_all(parts[0].parent), rows_of_messages(messages))


@pytest.mark.parametrize("storage", ["db3", "mcap2", "db3-file"])
def test_folder_can_be_given_in_any_form(
    messages: list[Said], storage: str, written: Write
) -> None:
    folder = written(messages, storage)
    rows = rows_of_messages(messages)
    assert_same(read_all(folder / "metadata.yaml"), rows)
    files = [each for each in folder.iterdir() if each.name != "metadata.yaml"]
    assert_same(read_all(*files), rows)
    (folder / "metadata.yaml").unlink()
    assert_same(read_all(folder), rows)


@pytest.mark.parametrize("storage", ["bag-lz4", "mcap-zstd", "db3"])
def test_storage_is_detected_without_suffix(
    messages: list[Said], storage: str, written: Write, tmp_path: Path
) -> None:
    path = one_file(written(messages, storage))
    rows = rows_of_messages(messages)
    for name in ("none", "a.bag.active", "b.mcap", "c.bag", "d.db3", "e.yaml"):
        shutil.copy(path, tmp_path / name)
        assert_same(read_all(tmp_path / name), rows)


# Files given as one recording that may be two


def _part(path: Path, start: float, storage: str = "mcap-none") -> Path:
    """1.5 s of messages."""
    messages = said_on()
    for each in messages:
        each.log_ns += round(start * 1e9)
    return write_log(path, messages, storage)


def test_parts_of_one_recording_raise_no_warning(tmp_path: Path) -> None:
    parts = [_part(tmp_path / "a.mcap", 0.0), _part(tmp_path / "b.mcap", 1.4)]
    parts.append(_part(tmp_path / "c.bag", 20.0, "bag-none"))
    data = open_log(parts).read(["/imu"])
    assert len(data.imus["/imu"]) == 3 * len(open_log(parts[:1]).read(["/imu"]).imus["/imu"])
    assert warnings(data.findings) == warnings(open_log(parts[:1]).read(["/imu"]).findings) == ()


def test_overlapping_files_are_reported(tmp_path: Path) -> None:
    first, second = _part(tmp_path / "a.mcap", 0.0), _part(tmp_path / "b.mcap", 0.5)
    (told,) = warnings(open_log([second, first]).read(["/joint_states"]).findings)
    assert told == (
        f"{first} and {second} overlap by 0.995 s: if they are two recordings, name each alone"
    )
    again = _part(tmp_path / "c.mcap", 0.0)
    assert len(warnings(open_log([first, second, again]).read(["/joint_states"]).findings)) == 2
