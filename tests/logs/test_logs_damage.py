"""Damaged, foreign and missing files: what is sound is used, or one clear line says why not."""

from __future__ import annotations

import contextlib
import os
import sqlite3
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter

from imucalib_cli.errors import ImucalibError, InputError
from imucalib_cli.logs.log import LogData, open_log
from tests.logs.logs_samples import mixed_messages, write_mcap

if TYPE_CHECKING:
    from pathlib import Path

    from tests.logs.logs_samples import Said, Write

IMU = "sensor_msgs/msg/Imu"
SINGLE = ("bag-none", "bag-bz2", "bag-lz4", "mcap-none", "mcap-lz4", "mcap-zstd", "db3")


def read_all(path: Path) -> LogData:
    log = open_log([path])
    return log.read(topic.name for topic in log.topics if topic.kinds and topic.count)


def one_file(path: Path) -> Path:
    return next(path.glob("*.db3")) if path.is_dir() else path


def assert_prefix(data: LogData, whole: LogData) -> int:
    """All of what was read is in the whole; the number of IMU messages."""
    for topic, imu in data.imus.items():
        count = len(imu)
        np.testing.assert_array_equal(imu.log_ns, whole.imus[topic].log_ns[:count])
        np.testing.assert_array_equal(imu.gyro, whole.imus[topic].gyro[:count])
    return sum(len(imu) for imu in data.imus.values())


@pytest.mark.parametrize("storage", SINGLE)
def test_truncated_log_is_used_up_to_the_cut(
    messages: list[Said], storage: str, written: Write, tmp_path: Path
) -> None:
    path = one_file(written(messages, storage))
    whole = read_all(path)
    content = path.read_bytes()
    cut = tmp_path / "cut"
    for share in (0.99, 0.8, 0.5, 0.3):
        cut.write_bytes(content[: int(len(content) * share)])
        data = read_all(cut)
        count = assert_prefix(data, whole)
        assert count > (share - 0.25) * len(whole.imus["/imu"])
        if share < 0.95:  # nothing but the index stands at the end of an MCAP file
            assert data.losses
            assert str(cut) in data.losses[0]


@pytest.mark.parametrize("storage", ["mcap-none", "bag-none", "mcap-zstd", "bag-lz4"])
def test_log_without_its_end_loses_nothing(
    messages: list[Said], storage: str, written: Write, tmp_path: Path
) -> None:
    """As a crash leaves it: all chunks there, the index at the end not."""
    path = written(messages, storage)
    whole = read_all(path)
    content = path.read_bytes()
    crashed = tmp_path / "crashed"
    if storage.startswith("bag"):
        end = int.from_bytes(content[content.index(b"index_pos=") + 10 :][:8], "little")
        content = content[:end].replace(
            b"index_pos=" + end.to_bytes(8, "little"), b"index_pos=" + bytes(8)
        )
    else:
        end = int.from_bytes(content[-8 - 20 : -8 - 12], "little")
        content = content[: end - 13]  # DataEnd goes as well
    crashed.write_bytes(content)
    data = read_all(crashed)
    assert assert_prefix(data, whole) == 300
    assert data.losses


@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False},
        {"use_chunking": False, "index_types": IndexType.NONE, "use_statistics": False},
        {"index_types": IndexType.NONE},
        {"index_types": IndexType.CHUNK},
        {"index_types": IndexType.MESSAGE},
        {"use_statistics": False},
        {"repeat_channels": False, "repeat_schemas": False},
        {"use_summary_offsets": False, "enable_crcs": False},
        {"chunk_size": 100_000_000},
    ],
)
def test_mcap_without_parts_of_its_index(
    messages: list[Said], options: dict[str, Any], written: Write, tmp_path: Path
) -> None:
    whole = read_all(written(messages, "mcap-none"))
    path = tmp_path / "odd.mcap"
    write_mcap(path, messages, **{"chunk_size": 20_000, **options})
    data = read_all(path)
    assert assert_prefix(data, whole) == 300
    assert len(data.poses["/tf"]) == 3
    assert data.losses == ()


def test_other_encodings_beside_do_no_harm(messages: list[Said], tmp_path: Path) -> None:
    path = tmp_path / "foxglove.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, compression=CompressionType.ZSTD)
        writer.start(profile="")
        json = writer.register_schema("imu", "jsonschema", b"{}")
        plot = writer.register_channel("/plot", "json", json)
        naked = writer.register_channel("/naked", "protobuf", 0)
        cdr = writer.register_channel(
            "/imu", "cdr", writer.register_schema(IMU, "ros2msg", b"broken definition")
        )
        for each in messages:
            if each.topic == "/imu":
                writer.add_message(cdr, each.log_ns, each.cdr(), each.log_ns)
                writer.add_message(plot, each.log_ns, b'{"a": 1}', each.log_ns)
                writer.add_message(naked, each.log_ns, b"\x08\x01", each.log_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    log = open_log([path])
    assert [(each.name, each.encoding, [*each.kinds]) for each in log.topics] == [
        ("/imu", "cdr", ["imu"]),
        ("/naked", "protobuf", []),
        ("/plot", "json", []),
    ]
    data = log.read(["/imu"])
    assert len(data.imus["/imu"]) == 300
    assert data.losses == ()


@pytest.mark.parametrize("storage", ["bag-none", "mcap-zstd", "db3"])
def test_unfit_messages_are_left_out_and_counted(
    messages: list[Said], storage: str, written: Write
) -> None:
    imus = [each for each in messages if each.topic == "/imu"]
    whole = imus[3].ros1() if storage.startswith("bag") else imus[3].cdr()
    imus[3].raw = b""
    imus[4].raw = b"\x00\x01\x00\x00"
    imus[5].raw = whole[:-50]
    imus[6].raw = whole + bytes(9)
    imus[7].raw = b"\xff" * len(whole)
    if storage == "db3":  # XCDR2, which rosbags does not read either
        imus[8].raw = b"\x00\x07" + whole[2:]
    data = read_all(one_file(written(imus, storage)))
    bad = 6 if storage == "db3" else 5
    assert len(data.imus["/imu"]) == 300 - bad
    assert data.losses == (
        f"/imu: {bad} of 300 messages do not fit sensor_msgs/Imu and are left out",
    )


def test_write_ahead_log_left_by_a_crash_is_read(messages: list[Said], written: Write) -> None:
    path = one_file(written(messages[:100], "db3"))
    before = len(read_all(path).imus["/imu"])
    with sqlite3.connect(path) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("PRAGMA wal_autocheckpoint=0")
        database.execute(
            "INSERT INTO messages (topic_id, timestamp, data) "
            "SELECT topic_id, timestamp + 1000000000000, data FROM messages"
        )
        database.commit()
        assert path.with_name(path.name + "-wal").stat().st_size > 0
        assert len(read_all(path).imus["/imu"]) == 2 * before
    database.close()


def test_damaged_chunk_costs_only_itself(messages: list[Said], tmp_path: Path) -> None:
    """A wrong byte among wanted messages is found by the chunk's checksum."""
    imus = [each for each in messages if each.topic == "/imu"]
    path = tmp_path / "flipped.mcap"
    write_mcap(path, imus, chunk_size=20_000, compression=CompressionType.NONE)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    data = read_all(path)
    assert 200 < len(data.imus["/imu"]) < 300
    assert any("checksum" in loss for loss in data.losses)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (b"hello world, this is no log", "is not a log"),
        (b"SQLite format 3\x00" + bytes(100), "no readable rosbag2 database"),
        (b"\x28\xb5\x2f\xfd nonsense", "cannot be unpacked"),
    ],
)
def test_foreign_file_is_refused_in_one_line(content: bytes, says: str, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError, match=says) as caught:
        open_log([path])
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "content", [b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"#ROSBAG V2.0\n\xff\xff"]
)
def test_log_without_messages_has_no_topics(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(content)
    log = open_log([path])
    assert log.topics == ()
    assert log.findings


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nope\.bag does not exist"):
        open_log([tmp_path / "nope.bag"])
    with pytest.raises(InputError, match="holds no log"):
        open_log([tmp_path])


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_forbidden_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.bag"
    path.write_bytes(b"x")
    path.chmod(0)
    with pytest.raises(InputError, match="may not be read"):
        open_log([path])


@pytest.mark.slow
@pytest.mark.parametrize("storage", ["bag-none", "bag-lz4", "mcap-none", "mcap-zstd", "db3"])
@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    derandomize=True,
)
@given(data=st.data())
def test_no_damage_raises_anything_but_our_errors(
    storage: str, data: st.DataObject, written: Write, tmp_path: Path
) -> None:
    source = tmp_path / f"sound-{storage}"
    if not source.exists():
        path = one_file(written(mixed_messages(30), storage, chunk_bytes=4000))
        source.write_bytes(path.read_bytes())
    content = bytearray(source.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        # Heads, tails and indexes are where lengths live.
        at = data.draw(
            st.one_of(
                st.integers(0, len(content) - 1),
                st.integers(0, min(600, len(content) - 1)),
                st.integers(max(0, len(content) - 2500), len(content) - 1),
            )
        )
        size = data.draw(st.sampled_from([1, 1, 2, 4, 8, 50]))
        fill = data.draw(st.sampled_from([b"\x00", b"\xff", b"\x7f", b"\x01"]))
        content[at : at + size] = fill * len(content[at : at + size])
    damaged = tmp_path / "damaged"
    damaged.write_bytes(content[: data.draw(st.sampled_from([len(content), len(content) // 2]))])
    with contextlib.suppress(ImucalibError):
        read_all(damaged)
