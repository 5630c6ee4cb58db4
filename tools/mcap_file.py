"""MCAP files of any payloads, by the mcap library, for tests and documents."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from mcap.writer import Writer

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path


class Payload(NamedTuple):
    """Bytes of a message, and what tells how to read them."""

    topic: str
    encoding: str
    schema: tuple[str, str, bytes] | None
    """Name, encoding and text of the type."""
    data: bytes
    log_ns: int


def write_payloads(
    path: Path, payloads: Iterable[Payload], *, profile: str = "", **options: Any
) -> Path:
    """Payloads in their order; the options are the library's."""
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile=profile)
        channels: dict[tuple[object, ...], int] = {}
        for number, (topic, encoding, schema, data, log_ns) in enumerate(payloads):
            key = (topic, encoding, schema)
            if key not in channels:
                schema_id = writer.register_schema(*schema) if schema else 0
                channels[key] = writer.register_channel(topic, encoding, schema_id)
            writer.add_message(channels[key], log_ns, data, max(log_ns - 5, 0), number)
        writer.finish()  # type: ignore[no-untyped-call]
    return path
