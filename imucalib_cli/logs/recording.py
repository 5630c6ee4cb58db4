"""From a path to the files of a recording, by what they contain."""

from __future__ import annotations

import re
import stat
from pathlib import Path
from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.findings import warning

if TYPE_CHECKING:
    from imucalib_cli.logs.storage import Storage

_MCAP = b"\x89MCAP0\r\n"
_BAG = b"#ROSBAG V2.0\n"
_DB3 = b"SQLite format 3\x00"
_ZSTD = b"\x28\xb5\x2f\xfd"
_METADATA = b"rosbag2_bagfile_information"
_KNOWN = "a ROS 1 bag, a ROS 2 folder or .db3, or an MCAP file"


def open_storages(path: Path) -> list[Storage]:
    """Open the files of a recording.

    Raises:
        InputError: Missing, unreadable, empty or not a log.
        ChoiceError: A folder without metadata.yaml holds several recordings.
    """
    try:
        if stat.S_ISDIR(_mode(path)):
            return _open_folder(path)
        head = _head(path)
        if path.suffix in {".yaml", ".yml"} and _METADATA in head:
            return _open_folder(path.parent)
        return [_open_file(path, head)]
    except FileNotFoundError as error:
        raise InputError(f"{path} {_why_missing(path)}") from error
    except PermissionError as error:
        named = error.filename or path
        raise InputError(f"{named} may not be read: check its permissions") from error
    except OSError as error:
        named = error.filename or path
        raise InputError(f"{named} cannot be read: {error.strerror or error}") from error


def _mode(path: Path) -> int:
    """Kind of file, before it is opened: opening a pipe would wait for who writes into it.

    Raises:
        InputError: It is neither a file nor a folder.
        OSError: It cannot be looked at; a link may lead nowhere, or in a circle.
    """
    mode = path.stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise InputError(
            f"{path} is a pipe or a device; a log is read here and there, not from front to back: "
            "write it to a file first"
        )
    return mode


def _why_missing(path: Path) -> str:
    """What a user may have overlooked about a path that leads to nothing."""
    broken = next((each for each in (path, *path.parents) if each.is_symlink()), None)
    if broken is not None and not broken.exists():
        return f"leads nowhere: the link {broken} points to {broken.readlink()}, which is not there"
    return "does not exist: check the path"


def _head(path: Path) -> bytes:
    _mode(path)
    with path.open("rb") as file:
        return file.read(512)


def holds_log(path: Path) -> bool:
    """Whether a file is one of a recording, by its content; False where it cannot be read."""
    try:
        head = _head(path)
    except (OSError, InputError):
        return False
    return _is_log(head) or _METADATA in head


def _is_log(head: bytes) -> bool:
    return head.startswith((_MCAP, _BAG, _DB3, _ZSTD))


def _open_file(path: Path, head: bytes) -> Storage:
    if head.startswith(_MCAP):
        from imucalib_cli.logs.mcap_file import McapFile

        return McapFile(path)
    if head.startswith(_BAG):
        from imucalib_cli.logs.bag_file import BagFile

        return BagFile(path)
    if head.startswith(_DB3):
        from imucalib_cli.logs.db3_file import Db3File

        return Db3File(path)
    if head.startswith(_ZSTD):
        from imucalib_cli.logs.unpacked import unpack

        unpacked, loss = unpack(path)
        head = _head(unpacked)
        if head.startswith(_ZSTD):
            raise InputError(f"{path} is compressed twice: unpack it with zstd -d")
        try:
            storage = _open_file(unpacked, head)
        except InputError as error:  # which names a temporary file that is nobody's
            cut = "" if loss is None else ", as far as it could be unpacked"
            raise InputError(f"{path} unpacks to no log{cut}: expected {_KNOWN}") from error
        storage.path = path
        if loss is not None:
            storage.losses.append(loss)
        return storage
    if not head:
        raise InputError(f"{path} is empty: record or copy it again")
    raise InputError(f"{path} is not a log: expected {_KNOWN}")


def _open_folder(folder: Path) -> list[Storage]:
    named = _listed(folder) or []
    missing = [each for each in named if not each.is_file()]
    found = _guessed(folder) if len(missing) == len(named) else named
    if not found:
        raise InputError(f"{folder} holds no log: expected {_KNOWN}")
    storages: list[Storage] = []
    losses = [warning("log.part_missing", name=each.name) for each in missing]
    unusable: list[InputError] = []
    for path in found:
        if path in missing:
            continue
        try:
            storages.append(_open_file(path, _head(path)))
        except InputError as error:  # what a crash left of the last part costs only that part
            unusable.append(error)
            losses.append(warning("log.part_unusable", reason=str(error)))
    if not storages:
        raise unusable[0]
    storages[0].losses += losses
    return storages


def _listed(folder: Path) -> list[Path] | None:
    """Files named by metadata.yaml; None where it is missing or broken."""
    metadata = folder / "metadata.yaml"
    if not metadata.is_file():
        return None
    from imucalib_cli.guarded_yaml import load_one, read_bounded

    try:
        with metadata.open("rb") as file:
            content = load_one(read_bounded(file, "replace"))
        names = content["rosbag2_bagfile_information"]["relative_file_paths"]
        if not isinstance(names, list):
            return None
        # Early rosbag2 wrote the folder's name in front.
        named = dict.fromkeys(Path(name).name for name in names)
    except (KeyError, TypeError, ValueError):
        return None
    return [folder / name for name in named if name] or None


def _guessed(folder: Path) -> list[Path]:
    """Log files of a folder without metadata: one recording, if their names say so."""
    logs = [each for each in sorted(folder.iterdir()) if each.is_file() and _is_log(_head(each))]
    recordings = {re.sub(r"(_\d+)?(\.\w+)*$", "", each.name) for each in logs}
    if len(recordings) > 1:
        names = ", ".join(each.name for each in logs)
        raise ChoiceError(f"{folder} holds several recordings, name one of them: {names}")
    return sorted(logs, key=_natural)


def _natural(path: Path) -> list[tuple[int, str]]:
    return [
        (int(part or 0), "") if part.isdigit() else (0, part)
        for part in re.split(r"(\d+)", path.name)
    ]
