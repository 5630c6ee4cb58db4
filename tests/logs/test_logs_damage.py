"""Damaged, foreign and huge logs: valid parts are used, or one clear line gives the reason."""

import contextlib
import io
import resource
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, IndexType

from imucalib_cli.errors import ImucalibError, InputError
from imucalib_cli.findings import warnings
from imucalib_cli.logs import unpacked
from imucalib_cli.logs.decoding import decode
from imucalib_cli.logs.log import LogData, open_log
from tests.logs.logs_samples import (
    CHUNKED,
    Said,
    Write,
    mixed_messages,
    one_file,
    read_all,
    said_on,
    write_log,
    write_mcap,
)
from tools.mcap_file import Payload, write_payloads


@pytest.fixture
def damaged(tmp_path: Path) -> Path:
    """Where a test writes its damaged log."""
    return tmp_path / "damaged"


def assert_prefix(data: LogData, whole: LogData) -> int:
    """All of what was read is in the whole; the number of IMU messages."""
    for topic, imu in data.imus.items():
        count = len(imu)
        np.testing.assert_array_equal(imu.log_ns, whole.imus[topic].log_ns[:count])
        np.testing.assert_array_equal(imu.gyro, whole.imus[topic].gyro[:count])
    return sum(len(imu) for imu in data.imus.values())


def assert_part(data: LogData, said: list[Said], at_least: int) -> None:
    """Every message read was written, none is read twice, and most are there."""
    imu = data.imus["/imu"]
    known = {each.log_ns: each.message.angular_velocity for each in said}
    assert len(set(imu.log_ns.tolist())) == len(imu)
    for ns, gyro in zip(imu.log_ns.tolist(), imu.gyro, strict=True):
        assert (known[ns].x, known[ns].y, known[ns].z) == tuple(gyro)
    assert at_least <= len(imu) <= len(said)


def assert_read(content: bytearray, damaged: Path, said: list[Said], least: int, loss: str) -> None:
    """Of damaged content so many messages are read, and a loss with these words is reported."""
    damaged.write_bytes(content)
    data = read_all(damaged)
    assert_part(data, said, at_least=least)
    assert any(loss in each for each in warnings(data.findings))


def without_index(content: bytes) -> bytearray:
    """As a crash leaves the file: everything up to the index."""
    if content.startswith(b"#ROSBAG"):
        end = content[content.index(b"index_pos=") + 10 :][:8]
        content = content[: int.from_bytes(end, "little")]
        return bytearray(content.replace(b"index_pos=" + end, b"index_pos=" + bytes(8)))
    return bytearray(content[: int.from_bytes(content[-28:-20], "little") - 13])  # and DataEnd


def chunks_of(content: bytes | bytearray) -> list[tuple[int, int]]:
    """Begin and end of the chunk records, in a bag with their message indexes."""
    at, found = 8, []
    if content.startswith(b"#ROSBAG"):
        parts = bytes(content).split(b"compression=")
        starts = np.cumsum([len(each) + 12 for each in parts[:-1]]) - 20
        return list(zip(starts.tolist(), [*starts[1:].tolist(), len(content)], strict=True))
    while at + 9 <= len(content):
        opcode, length = struct.unpack_from("<BQ", content, at)
        if opcode == 6:
            found.append((at, at + 9 + length))
        at += 9 + length
    return found


def mcap(
    tmp_path: Path, compression: str, *, index: bool = False, **options: Any
) -> tuple[list[Said], bytearray]:
    """IMU messages, and a file of them."""
    said, path = said_on("/imu"), tmp_path / "sound.mcap"
    kind = CompressionType[compression.upper()]
    write_mcap(path, said, **{"chunk_size": 8000, "compression": kind, **options})
    content = path.read_bytes()
    return said, bytearray(content) if index else without_index(content)


@pytest.mark.parametrize("storage", [*CHUNKED, "db3"])
def test_truncated_log_is_used_up_to_the_cut(
    messages: list[Said], storage: str, written: Write, damaged: Path
) -> None:
    path = one_file(written(messages, storage))
    whole = read_all(path)
    content = path.read_bytes()
    for share in (0.99, 0.3):
        damaged.write_bytes(content[: int(len(content) * share)])
        data = read_all(damaged)
        count = assert_prefix(data, whole)
        assert count > (share - 0.25) * len(whole.imus["/imu"])
        if share < 0.95:  # an MCAP file ends with the index alone
            assert warnings(data.findings)
            assert str(damaged) in warnings(data.findings)[0]


@pytest.mark.parametrize(
    ("storage", "junk"), [*((storage, b"") for storage in CHUNKED), ("mcap-zstd", b"\5junk")]
)
def test_log_without_index_loses_no_message(
    messages: list[Said], storage: str, junk: bytes, written: Write, damaged: Path
) -> None:
    """As a crash leaves it: all chunks there, the index at the end not."""
    path = written(messages, storage)
    damaged.write_bytes(without_index(path.read_bytes()) + junk)
    data = read_all(damaged)
    assert assert_prefix(data, read_all(path)) == 300
    assert warnings(data.findings)


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
def test_mcap_with_partial_index_is_read(
    messages: list[Said], options: dict[str, Any], written: Write, tmp_path: Path
) -> None:
    whole = read_all(written(messages, "mcap-none"))
    path = tmp_path / "odd.mcap"
    write_mcap(path, messages, **{"chunk_size": 20_000, **options})
    data = read_all(path)
    assert assert_prefix(data, whole) == 300
    assert len(data.poses["/tf"]) == 3
    assert warnings(data.findings) == ()


def test_other_encodings_do_not_affect_reading(messages: list[Said], tmp_path: Path) -> None:
    broken = ("sensor_msgs/msg/Imu", "ros2msg", b"broken definition")
    payloads = [
        payload
        for each in messages
        if each.topic == "/imu"
        for payload in (
            Payload("/imu", "cdr", broken, each.cdr(), each.log_ns),
            Payload("/plot", "json", ("imu", "jsonschema", b"{}"), b'{"a": 1}', each.log_ns),
            Payload("/naked", "protobuf", None, b"\x08\x01", each.log_ns),
        )
    ]
    path = write_payloads(tmp_path / "foxglove.mcap", payloads)
    log = open_log([path])
    assert [(each.name, each.encoding, [*each.kinds]) for each in log.topics] == [
        ("/imu", "cdr", ["imu"]),
        ("/naked", "protobuf", []),
        ("/plot", "json", []),
    ]
    data = log.read(["/imu"])
    assert len(data.imus["/imu"]) == 300
    assert warnings(data.findings) == ()


@pytest.mark.parametrize("storage", ["bag-none", "mcap-zstd", "db3"])
def test_invalid_messages_are_skipped_and_counted(storage: str, written: Write) -> None:
    imus = said_on("/imu")
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
    assert warnings(data.findings) == (
        f"/imu: {bad} of 300 messages do not fit sensor_msgs/Imu and are left out",
    )


@pytest.mark.parametrize("storage", ["bag-none", "mcap-zstd"])
def test_frame_of_joint_states_may_be_anything(storage: str, written: Write) -> None:
    """It is not used; whatever its bytes, the positions are sound."""
    joints = said_on("/joint_states")
    for each in joints:
        header = replace(each.message.header, frame_id="a\tframe")
        each.message = replace(each.message, header=header)
    data = read_all(one_file(written(joints, storage)))
    assert sum(map(len, data.joints["/joint_states"])) == len(joints)
    assert warnings(data.findings) == ()


def test_damaged_chunk_loses_only_its_messages(tmp_path: Path, damaged: Path) -> None:
    """A wrong byte among wanted messages is found by the chunk's checksum."""
    said, content = mcap(tmp_path, "none", index=True, chunk_size=20_000)
    content[len(content) // 2] ^= 1
    damaged.write_bytes(content)
    data = read_all(damaged)
    assert_part(data, said, at_least=201)
    assert len(data.imus["/imu"]) < 300
    assert any("checksum" in loss for loss in warnings(data.findings))


def test_wiped_summary_loses_no_message(tmp_path: Path, damaged: Path) -> None:
    said, content = mcap(tmp_path, "zstd", index=True)
    start = int.from_bytes(content[-28:-20], "little")
    content[start:-37] = bytes(len(content) - 37 - start)  # up to the footer
    assert_read(content, damaged, said, len(said), "")


@pytest.mark.parametrize(
    ("how", "storage"),
    [
        *product(("length", "kind", "wiped", "removed", "inserted"), CHUNKED),
        *product(("flipped",), ("bag-bz2", "mcap-none", "mcap-lz4", "mcap-zstd")),
        *product(("unknown",), ("bag-lz4", "bag-bz2", "mcap-lz4", "mcap-zstd")),
    ],
)
def test_log_without_index_is_read_past_damage(
    storage: str, how: str, written: Write, damaged: Path
) -> None:
    said = said_on("/imu")
    content = without_index(written(said, storage, chunk_bytes=8000).read_bytes())
    chunks = chunks_of(content)
    assert len(chunks) > 8
    start, end = chunks[3]
    is_bag = storage.startswith("bag")
    match how:
        case "length":
            size = int.from_bytes(content[start : start + 4], "little")
            at, width = (start + 4 + size, 4) if is_bag else (start + 1, 8)
            content[at : at + width] = b"\xff" * width
        case "kind":
            at = content.index(b"op=\x05", start) + 3 if is_bag else start
            content[at] = 0x55 if is_bag else 0
        case "wiped":
            content[start - 30 : start + 200] = bytes(230)
        case "removed":
            del content[start + (2 if is_bag else 30) : end - 10]
        case "flipped":
            content[(start + end) // 2] ^= 0x55
        case "unknown":
            at = content.index(storage.partition("-")[2].encode(), start)
            content[at : at + 2] = b"xx"
        case _:
            content[start:start] = b"\x05junk of another file" * 7
    # A wrong length costs nothing of what a chunk holds, nor does junk before an MCAP's.
    whole = how == "length" or (how == "inserted" and not is_bag)
    whole |= how == "kind" and storage.endswith("none")
    least = len(said) * (len(chunks) - 2) // len(chunks) - 1
    known = {"flipped": "", "unknown": "is not known"}.get(how, "damaged")
    known = "checksum" if (how, storage) == ("flipped", "mcap-none") else known
    assert_read(content, damaged, said, len(said) if whole else least, known)


def test_messages_of_a_chunk_without_header_are_found(tmp_path: Path, damaged: Path) -> None:
    said, content = mcap(tmp_path, "none")
    start, _ = chunks_of(content)[3]
    content[start : start + 60] = bytes(60)
    assert_read(content, damaged, said, len(said) - 2, "")


def test_unchunked_mcap_is_read_past_damage(tmp_path: Path, damaged: Path) -> None:
    said, content = mcap(tmp_path, "none", use_chunking=False)
    heads, at = [], 8
    while at + 9 <= len(content):
        heads.append(at)
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    for share in (0.2, 0.5, 0.8):
        at = heads[int(share * len(heads))]
        content[at : at + 40] = b"\xff" * 40
    damaged.write_bytes(content)
    data = read_all(damaged)
    assert_part(data, said, at_least=len(said) - 6)
    assert sum("are damaged and left out" in loss for loss in warnings(data.findings)) == 3


def test_damaged_chunk_without_checksum_is_reported(tmp_path: Path, damaged: Path) -> None:
    said, content = mcap(tmp_path, "none", enable_crcs=False)
    start, end = chunks_of(content)[3]
    at = content.index(b"\x05", start + 41)
    while at < (start + end) // 2:
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    content[at : at + 9] = bytes(9)
    assert_read(content, damaged, said, len(said) - 30, "is damaged inside")


def test_premature_end_of_data_record_is_ignored(tmp_path: Path, damaged: Path) -> None:
    """A wiped record that looks like the end must not hide the rest without a warning."""
    said, content = mcap(tmp_path, "zstd")
    start, _ = chunks_of(content)[3]
    content[start : start + 13] = struct.pack("<BQI", 15, 4, 0)
    assert_read(content, damaged, said, len(said) // 2, "")


def test_bag_with_damaged_message_index_is_scanned(written: Write, damaged: Path) -> None:
    said = said_on("/imu")
    content = bytearray(written(said, "bag-lz4", chunk_bytes=8000).read_bytes())
    content[content.index(b"ver=\x01", len(content) // 3) + 4] = 9
    damaged.write_bytes(content)
    assert len(read_all(damaged).imus["/imu"]) == len(said)


def test_index_listing_missing_messages_is_reported(tmp_path: Path, damaged: Path) -> None:
    said, content = mcap(tmp_path, "zstd", index=True)
    start, end = chunks_of(content)[3]
    content[start + 60 : end - 60] = bytes(end - start - 120)
    assert_read(content, damaged, said, 200, "messages that the index counts are there")


def test_many_losses_are_summarised(tmp_path: Path, damaged: Path) -> None:
    _, content = mcap(tmp_path, "zstd", chunk_size=1000)
    for start, _ in chunks_of(content)[::2]:
        content[start] = 0
    damaged.write_bytes(content)
    losses = warnings(read_all(damaged).findings)
    assert len(losses) < 12
    assert any("further losses" in loss for loss in losses)


@pytest.mark.parametrize(
    "content", [b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"#ROSBAG V2.0\n\xff\xff"]
)
def test_log_without_messages_has_no_topics(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(content)
    log = open_log([path])
    assert log.topics == ()
    assert log.findings


# Small files that unpack to a great deal


def zeros(size: int) -> bytes:
    """Zstandard of zeros."""
    packed = io.BytesIO()
    with zstandard.ZstdCompressor().stream_writer(packed, closefd=False) as writer:
        block = bytes(1 << 24)
        for _ in range(size >> 24):
            writer.write(block)
    return packed.getvalue()


@contextmanager
def limited(size: int) -> Iterator[None]:
    """Let this process take so many bytes more."""
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (now + size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def test_decompression_bomb_chunk_loses_only_its_messages(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_mcap(path, said_on("/imu", count=100), chunk_size=5000)
    content = path.read_bytes()
    data = zeros(2 << 30)
    head = struct.pack("<QQQI", 0, 0, 2 << 30, zlib.crc32(b"")) + struct.pack("<I4s", 4, b"zstd")
    body = head + struct.pack("<Q", len(data)) + data
    bomb = struct.pack("<BQ", 6, len(body)) + body
    at = content.index(struct.pack("<I4s", 4, b"zstd")) - 9 - 28
    path.write_bytes(content[:at] + bomb + content[at:-100])
    with limited(1 << 30):
        data_read = open_log([path]).read(["/imu"])
    assert len(data_read.imus["/imu"]) == 100
    assert any("used as far as it can be unpacked" in loss for loss in warnings(data_read.findings))


@pytest.mark.slow
def test_decompression_bomb_messages_are_skipped(
    written: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = said_on("/imu", count=200)
    bomb = zeros(64 << 20)
    for each in said[::2]:
        each.raw = bomb
    path = written(said, "mcap-none")
    monkeypatch.setattr(decode, "BLOCK_BYTES", 1 << 26)  # else a block holds few of them
    with limited(1 << 29):
        data = open_log([path]).read(["/imu"])
    assert len(data.imus["/imu"]) == 100
    assert any("100 of 200 messages do not fit" in loss for loss in warnings(data.findings))


def test_decompression_bomb_file_is_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unpacked, "ALWAYS", 1 << 24)
    path = tmp_path / "log.db3.zstd"
    path.write_bytes(zeros(1 << 30))
    with pytest.raises(InputError) as caught:
        open_log([path])
    assert str(caught.value).startswith(
        f"{path} does not unpack to a log, as far as it could be unpacked"
    )
    target, loss = unpacked.unpack(path)
    assert target.stat().st_size < 1 << 28
    assert loss is not None
    assert (loss.code, loss.values["ratio"]) == ("log.unpacks_too_large", 1000)


def test_claimed_element_counts_are_not_trusted(written: Write) -> None:
    """Names, positions and transforms by the billion."""
    said = said_on("/joint_states", "/tf", count=60)
    rng = np.random.default_rng(3)
    for each in said[::3]:
        raw = bytearray(each.cdr())
        at = int(rng.integers(4, max(5, min(len(raw) - 4, 60)))) // 4 * 4
        raw[at : at + 4] = b"\xff\xff\xff\x7f"
        each.raw = bytes(raw)
    path = written(said, "mcap-none")
    with limited(1 << 28):
        data = open_log([path]).read(["/joint_states", "/tf"])
    assert data.joints["/joint_states"]
    assert any("do not fit" in loss for loss in warnings(data.findings))


@pytest.mark.parametrize(
    ("limit", "ratio", "most"),
    [("MESSAGES_ALWAYS", "MESSAGES_PER_BYTE", 0.02), ("BYTES_ALWAYS", "MOST_RATIO", 1)],
)
def test_memory_is_bounded_by_log_size(
    limit: str, ratio: str, most: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Chunk by chunk each is small: equal messages that pack to a byte or two."""
    monkeypatch.setattr(decode, limit, 1000)
    monkeypatch.setattr(decode, ratio, most)
    first, *_ = said_on("/imu", count=5)
    path = tmp_path / "log.mcap"
    write_mcap(path, [first] * 40_000, chunk_size=1 << 18)
    data = open_log([path]).read(["/imu"])
    assert 0 < len(data.imus["/imu"]) < 40_000
    assert any(
        "which no log does: the part before them is used" in loss
        for loss in warnings(data.findings)
    )


def test_temporary_copies_are_removed_when_reading_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    whole = one_file(write_log(tmp_path / "log", said_on("/imu", count=50), "db3")).read_bytes()
    packed, cut = tmp_path / "log.db3.zstd", tmp_path / "cut.db3"
    packed.write_bytes(zstandard.compress(whole))
    cut.write_bytes(whole[:-4096])
    for path in (packed, cut):
        with unpacked.removing_copies():
            assert open_log([path]).read(["/imu"]).imus
            assert len(list(temporary.iterdir())) == 1
        assert list(temporary.iterdir()) == []


def test_decompression_bomb_table_is_truncated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unpacked, "TABLE_ALWAYS", 1 << 20)
    path = tmp_path / "log.csv.zst"
    text = b"t_ns,gx,gy,gz,ax,ay,az\n" + b"1,0,0,0,0,0,9\n" * 500_000
    path.write_bytes(zstandard.compress(text))
    log = open_log([path])
    (topic,) = log.topics
    assert 0 < topic.count <= (1 << 20) // 14
    assert any(
        "unpacks to over 100 times its size" in loss
        for loss in warnings(log.read([topic.name]).findings)
    )


def test_well_compressed_log_is_read_completely(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An IMU at rest without noise, whose stamps alone differ."""
    monkeypatch.setattr(decode, "MESSAGES_ALWAYS", 1000)
    monkeypatch.setattr(decode, "BYTES_ALWAYS", 1000)
    first, *_ = said_on("/imu", count=5)
    path = tmp_path / "log.mcap"
    said = [replace(first, log_ns=first.log_ns + 5_000_000 * k) for k in range(5000)]
    write_mcap(path, said)
    data = open_log([path]).read(["/imu"])
    assert len(data.imus["/imu"]) == 5000
    assert warnings(data.findings) == ()


def test_claimed_lengths_are_not_allocated(tmp_path: Path, damaged: Path) -> None:
    """Gigabytes in every length field, one at a time."""
    content = write_log(tmp_path / "log", mixed_messages(30), "mcap-none", 4000).read_bytes()
    with limited(1 << 29):
        for claim in (b"\x00\x00\x00\x80", b"\xff\xff\xff\x7f", b"\xff\xff\xff\xff"):
            for at in [*range(8, 300, 13), *range(len(content) - 900, len(content) - 8, 47)]:
                damaged.write_bytes(content[:at] + claim + content[at + 4 :])
                with contextlib.suppress(ImucalibError):
                    read_all(damaged)
