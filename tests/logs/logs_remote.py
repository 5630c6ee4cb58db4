"""Large MCAP files for tests and benchmarks of remote reading, and what of them is wanted."""

from collections.abc import Collection
from pathlib import Path
from typing import IO, Any, cast

from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

CHUNK = 1 << 18
"""Bytes of a chunk of small messages."""


class _Sparse:
    """A file in which zeros at the end of what is written become holes."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def write(self, data: Any) -> int:
        body = bytes(data).rstrip(b"\0")
        self._file.write(body)
        self._file.seek(len(data) - len(body), 1)
        return len(data)

    def tell(self) -> int:
        return self._file.tell()


def with_images(
    source: Path, target: Path, *, size: int, image_bytes: int, apart: bool = True
) -> Path:
    """Copy an MCAP file, uncompressed, with images besides.

    Args:
        source: Whose messages are copied in order.
        target: Is written, with holes in place of the images' zeros.
        size: Bytes of all images.
        image_bytes: Of each.
        apart: Whether images are in chunks of their own.
    """
    with source.open("rb") as small, target.open("wb") as file:
        reader = make_reader(small)
        summary = reader.get_summary()
        assert summary is not None
        writer = McapWriter(
            cast("IO[bytes]", _Sparse(file)), chunk_size=CHUNK, compression=CompressionType.NONE
        )
        writer.start(profile="ros2")
        schemas = {
            key: writer.register_schema(each.name, each.encoding, each.data)
            for key, each in summary.schemas.items()
        }
        channels = {
            key: writer.register_channel(each.topic, each.message_encoding, schemas[each.schema_id])
            for key, each in summary.channels.items()
        }
        image = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", b"uint8[] data")
        camera = writer.register_channel("/camera", "cdr", image)
        messages = [message for _, _, message in reader.iter_messages()]
        images = max(1, size // image_bytes)
        each_after = max(1, len(messages) // images)
        written = 0
        for number, message in enumerate(messages):
            writer.add_message(
                channels[message.channel_id],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
            if number % each_after == each_after - 1 and written < images:
                if apart:
                    cast("Any", writer)._Writer__finalize_chunk()
                for _ in range(images // (len(messages) // each_after) + 1):
                    stamp = message.log_time
                    writer.add_message(camera, stamp, b"\1" + bytes(image_bytes - 1), stamp)
                    written += 1
        writer.finish()  # type: ignore[no-untyped-call]
        file.truncate()
    return target


def wanted_bytes(path: Path, topics: Collection[str]) -> int:
    """Bytes of the chunks that hold messages of some topics, by the mcap library."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    numbers = {key for key, each in summary.channels.items() if each.topic in topics}
    return sum(
        each.chunk_length
        for each in summary.chunk_indexes
        if not numbers.isdisjoint(each.message_index_offsets)
    )
