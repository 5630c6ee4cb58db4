"""Paths that are no plain files, files that change while being read, folders of odds and ends."""

import os
from pathlib import Path

import pytest

from imucalib_cli.errors import ChoiceError, ImucalibError, InputError
from imucalib_cli.findings import warnings
from imucalib_cli.logs.log import open_log
from tests.logs.logs_samples import (
    Said,
    T,
    Write,
    header,
    mixed_messages,
    one_file,
    said_on,
    write_log,
)

STORAGES = ("mcap-zstd", "mcap-none", "bag-lz4", "bag-none", "db3")


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        open_log([path])
    assert "\n" not in str(caught.value)
    assert path.name in str(caught.value)
    return str(caught.value)


def test_pipes_and_devices_are_refused_at_once(tmp_path: Path) -> None:
    """Opening a pipe would wait for whoever writes into it, for ever."""
    pipe = tmp_path / "pipe.mcap"
    os.mkfifo(pipe)
    assert "is a pipe or a device" in refused(pipe)
    assert "is a pipe or a device" in refused(Path("/dev/null"))
    (tmp_path / "link.bag").symlink_to("/dev/zero")
    assert "is a pipe or a device" in refused(tmp_path / "link.bag")
    assert "a log cannot be read from standard input" in refused(Path("-"))


def test_links_are_followed_and_broken_ones_named(written: Write, tmp_path: Path) -> None:
    path = written(mixed_messages(10), "mcap-none")
    link = tmp_path / "link.mcap"
    link.symlink_to(path)
    assert len(open_log([link]).read(["/imu"]).imus["/imu"]) == 10
    with pytest.raises(ChoiceError, match="given twice"):
        open_log([path, link])
    path.rename(tmp_path / "moved.mcap")
    assert "leads nowhere" in refused(link)
    assert "which does not exist" in refused(link)
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    assert "cannot be read: Too many levels of symbolic links" in refused(loop)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"SQLite format 3\x00" + bytes(100), "not a readable rosbag2 database"),
        (b"\x28\xb5\x2f\xfd nonsense", "cannot be unpacked"),
    ],
)
def test_foreign_files_are_refused(content: bytes, says: str, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    assert says in refused(path)
    assert str(path) in refused(path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_unreadable_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.bag"
    path.write_bytes(b"x")
    path.chmod(0)
    assert "may not be read" in refused(path)


def test_invalid_file_names_are_refused(tmp_path: Path) -> None:
    assert "cannot be read" in refused(tmp_path / ("x" * 300))
    file = tmp_path / "file"
    file.write_bytes(b"")
    with pytest.raises(InputError, match="Not a directory"):
        open_log([file / "log.bag"])


@pytest.mark.parametrize("storage", STORAGES)
def test_vanishing_or_shrinking_file_gives_no_traceback(
    storage: str, written: Write, messages: list[Said]
) -> None:
    path = one_file(written(messages, storage))
    content = path.read_bytes()
    for left in (None, b"", content[:100], content[: len(content) // 2]):
        path.write_bytes(content)
        log = open_log([path])
        if left is None:
            path.unlink()
            with pytest.raises(InputError, match=r"cannot be read any more: .*\S$"):
                log.read(["/imu"])
            continue
        path.write_bytes(left)
        try:
            data = log.read(["/imu"])
        except ImucalibError as error:
            assert "\n" not in str(error)  # noqa: PT017 - either way is right
        else:
            assert warnings(data.findings)


@pytest.mark.parametrize("storage", ["mcap-zstd", "bag-none"])
def test_growing_file_is_read_up_to_its_initial_size(
    storage: str, written: Write, messages: list[Said], tmp_path: Path
) -> None:
    content = written(messages, storage).read_bytes()
    path = tmp_path / "growing"
    path.write_bytes(content[: len(content) // 2])
    log = open_log([path])
    with path.open("ab") as file:
        file.write(content[len(content) // 2 :])
    count = len(log.read(["/imu"]).imus["/imu"])
    assert 60 < count < 200


def test_unusable_parts_lose_only_their_messages(tmp_path: Path) -> None:
    folder = write_log(tmp_path / "log", mixed_messages(20), "db3")
    metadata = folder / "metadata.yaml"
    name = next(folder.glob("*.db3")).name
    named = metadata.read_text()
    for index, content in enumerate((b"", b"SQLite format 3\0 and no more", b"something else")):
        other = f"part_{index}.db3"
        (folder / other).write_bytes(content)
        metadata.write_text(named.replace(f"- {name}", f"- {other}\n  - {name}"))
        data = open_log([folder]).read(["/imu"])
        assert len(data.imus["/imu"]) == 20
        assert any("left out" in loss and other in loss for loss in warnings(data.findings))
    (folder / name).write_bytes(b"")
    assert "is empty" in refused(folder / name)


@pytest.mark.parametrize(
    "text",
    [
        "rosbag2_bagfile_information: {relative_file_paths: [[x], 3, null]}",
        "rosbag2_bagfile_information: {relative_file_paths: ['']}",
        "rosbag2_bagfile_information: {relative_file_paths: ../../etc}",
        "when: 2020-13-45\nrosbag2_bagfile_information: {}",
        "[" * 5000,
        "a: &a [x,x,x,x,x,x,x,x,x]\n"
        + "".join(f"{chr(98 + k)}: &{chr(98 + k)} [{f'*{chr(97 + k)},' * 9}]\n" for k in range(9))
        + "rosbag2_bagfile_information: {relative_file_paths: *j}",
        "\x00\x01\x02",
    ],
)
def test_invalid_metadata_is_ignored(tmp_path: Path, text: str) -> None:
    folder = write_log(tmp_path / "log", mixed_messages(5), "db3")
    (folder / "metadata.yaml").write_text(text)
    assert len(open_log([folder]).read(["/imu"]).imus["/imu"]) == 5


def test_renamed_files_of_a_folder_are_found(tmp_path: Path) -> None:
    folder = write_log(tmp_path / "log", mixed_messages(5), "db3")
    path = next(folder.glob("*.db3"))
    path.rename(folder / "renamed.bag")
    data = open_log([folder]).read(["/imu"])
    assert len(data.imus["/imu"]) == 5
    assert any(
        f"{path.name} is named in metadata.yaml but is not" in loss
        for loss in warnings(data.findings)
    )


def test_invalid_strings_drop_only_their_messages(written: Write) -> None:
    """A frame name with control or invalid characters would be a frame of its own."""
    said = said_on("/vicon", count=40)
    for number, frame in enumerate(("wor\x00d", "wo\x1b[2Jd")):
        said[3 + number].message = T["TransformStamped"](
            header(said[3 + number].log_ns, frame), "drone", said[3].message.transform
        )
    said[7].raw = said[7].cdr().replace(b"world", b"wo\xff\xfed")
    data = open_log([written(said, "mcap-none")]).read(["/vicon"])
    (pose,) = data.poses["/vicon"]
    assert len(pose) == 37
    assert warnings(data.findings) == (
        "/vicon: 3 of 40 messages do not fit geometry_msgs/TransformStamped and are left out",
    )


def test_impossible_joint_positions_are_dropped_row_by_row(written: Write) -> None:
    said = [each for each in mixed_messages(60) if each.topic == "/joint_states"]
    arm = [each for each in said if len(each.message.name) == 3]
    for number, value in enumerate((float("nan"), float("inf"), 1e300, -1e12)):
        arm[5 + 3 * number].message.position[number % 3] = value
    for each in said:
        if len(each.message.name) == 1:
            each.message.position[0] = float("nan")
    data = open_log([written(said, "mcap-none")]).read(["/joint_states"])
    streams = {len(each.names): each for each in data.joints["/joint_states"]}
    assert len(streams[3]) == len(arm) - 4
    assert len(streams[1]) == len(said) - len(arm)  # a joint without an encoder
    assert warnings(data.findings) == (
        "/joint_states: 4 messages whose positions are not finite or beyond 1e+09 are left out",
    )
