"""Files that cannot be read, or not to their end."""

from __future__ import annotations

import os
import shutil
from typing import TYPE_CHECKING
from unittest.mock import patch

from tests.troubleshooting.scene import Scene, Seen, joint, noisy, provokes

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

LINK = '<link name="base_link" />'


def spoilt_urdf(edit: Callable[[str], str]) -> Callable[[Scene], Seen]:
    """A sound log beside a URDF that is none."""

    def provocation(scene: Scene) -> Seen:
        scene.urdf(edit)
        return scene.run(scene.writer().imu().joints().write())

    return provocation


def cut(path: Path, share: float) -> Path:
    """The first part of a file, as a full disk leaves it."""
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    return path


@provokes("no-file")
def _(scene: Scene) -> Seen:
    return scene.run(scene.path("log.mcap"))


@provokes("pipe")
def _(scene: Scene) -> Seen:
    os.mkfifo(scene.path("log.mcap"))
    return scene.run(scene.path("log.mcap"))


@provokes("empty")
def _(scene: Scene) -> Seen:
    scene.path("log.mcap").touch()
    return scene.run(scene.path("log.mcap"))


@provokes("not-a-log")
def _(scene: Scene) -> Seen:
    return scene.run(scene.urdf())


@provokes("no-log-in-folder")
def _(scene: Scene) -> Seen:
    scene.path("recording").mkdir()
    return scene.run(scene.path("recording"))


@provokes("several-recordings")
def _(scene: Scene) -> Seen:
    for name in ("a", "b"):
        log = scene.writer(name).imu().joints().write()
        shutil.copy(log, scene.path(f"{name}.mcap"))
        shutil.rmtree(scene.path(name))
    return scene.run(scene.folder)


@provokes("cut-short")
def _(scene: Scene) -> Seen:
    return scene.run(cut(scene.log(noisy("rihibot")), 0.8))


@provokes("cut-short-bag")
def _(scene: Scene) -> Seen:
    return scene.run(cut(scene.log(noisy("rihibot"), "log.bag"), 0.8))


@provokes("unindexed")
def _(scene: Scene) -> Seen:
    log = scene.log(noisy("rihibot"), "log.bag", compression="none")
    data = log.read_bytes()
    # The bag header says where the index begins; 0 says that the bag was never closed.
    at = data.index(b"index_pos=") + len(b"index_pos=")
    index = int.from_bytes(data[at : at + 8], "little")
    log.write_bytes((data[:at] + bytes(8) + data[at + 8 :])[:index])
    return scene.run(log)


@provokes("cut-short-db3")
def _(scene: Scene) -> Seen:
    return scene.run(cut(scene.log(noisy("rihibot"), "log.db3"), 0.8))


@provokes("damaged-chunk")
def _(scene: Scene) -> Seen:
    log = scene.log(noisy("rihibot"), compression="none")
    data = bytearray(log.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 64] = bytes(64)
    log.write_bytes(data)
    return scene.run(log)


@provokes("two-recordings")
def _(scene: Scene) -> Seen:
    recording = noisy("rihibot")
    return scene.run(scene.log(recording, "a.mcap"), scene.log(recording, "b.mcap"))


@provokes("overlap-of-files")
def _(scene: Scene) -> Seen:
    recording = noisy("rihibot")
    other = scene.log(recording, "b.mcap", imu_topic="/imu/other")
    return scene.run(scene.log(recording, "a.mcap"), other, "--imu-topic", "/imu/data")


@provokes("other-encoding")
def _(scene: Scene) -> Seen:
    from mcap.writer import Writer

    log = scene.path("log.mcap")
    with log.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(name="foxglove.Imu", encoding="jsonschema", data=b"{}")
        channel = writer.register_channel(topic="/imu", message_encoding="json", schema_id=schema)
        writer.add_message(channel, log_time=1, data=b"{}", publish_time=1)
        writer.finish()  # type: ignore[no-untyped-call]
    return scene.run(log)


provokes("xacro")(
    spoilt_urdf(
        lambda text: text.replace(
            "<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', 1
        ).replace(LINK, LINK + '<xacro:arm prefix="left_"/>')
    )
)
provokes("not-xml")(spoilt_urdf(lambda text: text.replace("</robot>", "")))
provokes("not-a-urdf")(spoilt_urdf(lambda _: '<sdf version="1.7"><model name="arm"/></sdf>'))
provokes("doctype")(
    spoilt_urdf(lambda text: text.replace("<robot", '<!DOCTYPE robot [<!ENTITY a "b">]><robot', 1))
)
provokes("undefined-link")(spoilt_urdf(lambda text: text.replace(LINK, "")))
provokes("two-roots")(spoilt_urdf(lambda text: text.replace(LINK, LINK + '<link name="table"/>')))
provokes("urdf-millimetres")(
    spoilt_urdf(lambda text: joint(text, "elbow_joint", "-0.6127 0 0", "-612700 0 0"))
)


@provokes("no-memory")
def _(scene: Scene) -> Seen:
    with patch("imucalib_cli.jobs.reading.open_log", side_effect=MemoryError):
        return scene.run("log.mcap")


@provokes("holds-too-much")
def _(scene: Scene) -> Seen:
    """As if the last tenth were too much."""
    log = scene.log(noisy("rihibot"))
    with (
        patch("imucalib_cli.logs.decode._MESSAGES_PER_BYTE", 0.0),
        patch("imucalib_cli.logs.decode._MESSAGES_ALWAYS", 4300),
    ):
        return scene.run(log)
