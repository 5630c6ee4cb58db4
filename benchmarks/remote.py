"""Bytes read of logs behind a URL, next to those of the chunks with wanted topics.

A web server in this process counts what it sends. The logs: an MCAP file of 1 GB, mostly images,
which are in chunks of their own or share those of the IMU; an MCAP file and a ROS 1 bag without
images. IMU and joint states, or poses, are read. Requests are answered at once, and after 50 ms,
as over a long line.

    python -m benchmarks.remote                  # 2 GB of disk, as holes where it knows them
    python -m benchmarks.remote --megabytes 100
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from rosbags.rosbag1 import Reader as BagReader

from benchmarks.common import arguments, table, timed
from imucalib_cli.logs.log import open_log
from imucalib_cli.logs.remote.file import RemoteFile
from tests.logs.logs_remote import wanted_bytes, with_images
from tests.web_server import serving

if TYPE_CHECKING:
    from collections.abc import Collection

SAMPLES = Path(__file__).parents[1] / "sample_data"
LINE_S = 0.05
"""s before each answer, of a long line."""


def bag_chunks(path: Path, topics: Collection[str]) -> int:
    """Bytes of the chunks of a bag that hold messages of some topics, by rosbags."""
    with BagReader(path) as bag:
        wanted = {each.id for each in bag.connections if each.topic in topics}
        return sum(
            chunk.datasize
            for info, chunk in zip(bag.chunk_infos, bag.chunks.values(), strict=True)
            if not wanted.isdisjoint(info.connection_counts)
        )


def row(name: str, path: Path, topics: Collection[str], wanted: int) -> tuple[object, ...]:
    """Bytes, requests and times of reading some topics of a log."""
    local = timed(lambda: open_log([path]).read(topics))
    with serving(path.parent) as web:
        fast = timed(lambda: open_log([RemoteFile(web.url(path.name))]).read(topics))
        sent, requests = web.sent, len(web.asked)
        web.behaviour.seconds_per_request = LINE_S
        slow = timed(lambda: open_log([RemoteFile(web.url(path.name))]).read(topics))
    sizes = (each / 1e6 for each in (path.stat().st_size, wanted, sent))
    return name, *sizes, sent / wanted, requests, local, fast, slow


def main() -> None:
    """Print the table of docs/performance.md."""
    size = arguments(__doc__, megabytes={"default": 1024, "help": "of images"}).megabytes << 20
    rihibot = SAMPLES / "rihibot.mcap"
    topics = ("/imu/data", "/joint_states")
    line = table(
        *("log", "MB|.0f", "wanted chunks, MB|.1f", "read, MB|.1f", "read / wanted|.3f"),
        *("requests", "s, on disk|.2f", "s, server|.2f", "s, server after 50 ms|.2f"),
    )
    with tempfile.TemporaryDirectory() as folder:
        for name, apart in (
            ("MCAP, images in chunks of their own", True),
            ("MCAP, images in the IMU's chunks", False),
        ):
            path = Path(folder) / "log.mcap"
            with_images(rihibot, path, size=size, image_bytes=1 << 20, apart=apart)
            line(*row(name, path, topics, wanted_bytes(path, topics)))
            path.unlink()
    line(*row("MCAP, zstd, no images", rihibot, topics, wanted_bytes(rihibot, topics)))
    bag, poses = SAMPLES / "barbot.bag", ("/imu/data", "/tf")
    line(*row("ROS 1 bag, no images", bag, poses, bag_chunks(bag, poses)))


if __name__ == "__main__":
    main()
