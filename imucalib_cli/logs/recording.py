"""From a path to the files of a recording, by what they contain."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError, InputError

if TYPE_CHECKING:
    from imucalib_cli.logs.storage import Storage

_MCAP = b"\x89MCAP0\r\n"
_BAG = b"#ROSBAG V2.0\n"
_DB3 = b"SQLite format 3\x00"
_ZSTD = b"\x28\xb5\x2f\xfd"
_KNOWN = "a ROS 1 bag, a ROS 2 folder or .db3, or an MCAP file"


def open_storages(path: Path) -> list[Storage]:
    """Open the files of a recording.

    Raises:
        InputError: Missing, unreadable, empty or not a log.
        ChoiceError: A folder without metadata.yaml holds several recordings.
    """
    try:
        if path.is_dir():
            return _open_folder(path)
        head = _head(path)
        if path.suffix in {".yaml", ".yml"} and b"rosbag2_bagfile_information" in head:
            return _open_folder(path.parent)
        return [_open_file(path, head)]
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist: check the path") from error
    except PermissionError as error:
        raise InputError(f"{path} may not be read: check its permissions") from error
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(512)


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
        storage = _open_file(unpacked, head)
        storage.path = path
        if loss:
            storage.losses.append(loss)
        return storage
    if not head:
        raise InputError(f"{path} is empty: record or copy it again")
    raise InputError(f"{path} is not a log: expected {_KNOWN}")


def _open_folder(folder: Path) -> list[Storage]:
    found = _listed(folder)
    if found is None:
        found = _guessed(folder)
    missing = [each for each in found if not each.is_file()]
    if len(missing) == len(found):
        raise InputError(f"{folder} holds no log: expected {_KNOWN}")
    storages = [_open_file(path, _head(path)) for path in found if path not in missing]
    for path in missing:
        storages[0].losses.append(f"{path.name} is named in metadata.yaml but is not there")
    return storages


def _listed(folder: Path) -> list[Path] | None:
    """Files named by metadata.yaml; None where it is missing or broken."""
    metadata = folder / "metadata.yaml"
    if not metadata.is_file():
        return None
    import yaml

    try:
        content = yaml.safe_load(metadata.read_text(encoding="utf-8", errors="replace"))
        names = content["rosbag2_bagfile_information"]["relative_file_paths"]
        # Early rosbag2 wrote the folder's name in front.
        return [folder / Path(str(name)).name for name in names] or None
    except (yaml.YAMLError, KeyError, TypeError):
        return None


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
