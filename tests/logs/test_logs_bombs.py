"""Little files that unpack to a great deal: what is sound is used, within a gigabyte."""

from __future__ import annotations

import io
import resource
import struct
import zlib
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import zstandard

from imucalib_cli.errors import InputError
from imucalib_cli.logs import unpacked
from imucalib_cli.logs.log import open_log
from imucalib_cli.logs.messages import decode
from tests.logs.logs_samples import mixed_messages, write_mcap

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.logs.logs_samples import Write


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


def test_a_chunk_that_unpacks_to_gigabytes_costs_only_itself(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    said = [each for each in mixed_messages(100) if each.topic == "/imu"]
    write_mcap(path, said, chunk_size=5000)
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
    assert any("used as far as it can be unpacked" in loss for loss in data_read.losses)


@pytest.mark.slow
def test_messages_that_unpack_to_gigabytes_are_left_out(
    written: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = [each for each in mixed_messages(200) if each.topic == "/imu"]
    bomb = zeros(64 << 20)
    for each in said[::2]:
        each.raw = bomb
    path = written(said, "mcap-none")
    monkeypatch.setattr(decode, "_BLOCK_BYTES", 1 << 26)  # else a block holds few of them
    with limited(1 << 29):
        data = open_log([path]).read(["/imu"])
    assert len(data.imus["/imu"]) == 100
    assert any("100 of 200 messages do not fit" in loss for loss in data.losses)


def test_a_file_that_unpacks_to_a_disk_full_is_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unpacked, "_ALWAYS", 1 << 24)
    path = tmp_path / "log.db3.zstd"
    path.write_bytes(zeros(1 << 30))
    with pytest.raises(InputError) as caught:
        open_log([path])
    assert str(caught.value).startswith(f"{path} unpacks to no log, as far as it could be unpacked")
    target, loss = unpacked.unpack(path)
    assert target.stat().st_size < 1 << 28
    assert loss is not None
    assert (loss.code, loss.values["ratio"]) == ("log.unpacks_too_large", 1000)


def test_counts_a_message_merely_claims_are_not_believed(written: Write) -> None:
    """Names, positions and transforms by the billion."""
    said = [each for each in mixed_messages(60) if each.topic in {"/joint_states", "/tf"}]
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
    assert any("do not fit" in loss for loss in data.losses)


@pytest.mark.parametrize(
    ("limit", "ratio", "most"),
    [("_MESSAGES_ALWAYS", "_MESSAGES_PER_BYTE", 0.02), ("_BYTES_ALWAYS", "MOST_RATIO", 1)],
)
def test_what_a_whole_log_holds_is_bounded_by_its_size(
    limit: str, ratio: str, most: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Chunk by chunk each is small: equal messages that pack to a byte or two."""
    monkeypatch.setattr(decode, limit, 1000)
    monkeypatch.setattr(decode, ratio, most)
    (first, *_) = (each for each in mixed_messages(5) if each.topic == "/imu")
    path = tmp_path / "log.mcap"
    write_mcap(path, [first] * 40_000, chunk_size=1 << 18)
    data = open_log([path]).read(["/imu"])
    assert 0 < len(data.imus["/imu"]) < 40_000
    assert any("which no log does: what stands before is used" in loss for loss in data.losses)


def test_a_table_that_unpacks_to_a_great_deal_is_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unpacked, "_TABLE_ALWAYS", 1 << 20)
    path = tmp_path / "log.csv.zst"
    text = b"t_ns,gx,gy,gz,ax,ay,az\n" + b"1,0,0,0,0,0,9\n" * 500_000
    path.write_bytes(zstandard.compress(text))
    log = open_log([path])
    (topic,) = log.topics
    assert 0 < topic.count <= (1 << 20) // 14
    assert any(
        "unpacks to over 100 times its size" in loss for loss in log.read([topic.name]).losses
    )


def test_a_log_that_packs_well_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An IMU at rest without noise, whose stamps alone differ."""
    monkeypatch.setattr(decode, "_MESSAGES_ALWAYS", 1000)
    monkeypatch.setattr(decode, "_BYTES_ALWAYS", 1000)
    (first, *_) = (each for each in mixed_messages(5) if each.topic == "/imu")
    path = tmp_path / "log.mcap"
    said = [replace(first, log_ns=first.log_ns + 5_000_000 * k) for k in range(5000)]
    write_mcap(path, said)
    data = open_log([path]).read(["/imu"])
    assert len(data.imus["/imu"]) == 5000
    assert data.losses == ()
