"""The formats of logs, and how a path becomes the files of a recording, by their content."""

from __future__ import annotations

import re
import stat
from pathlib import Path
from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.findings import warning
from imucalib_cli.logs.bag.file import BagFile
from imucalib_cli.logs.chunked.chunks import ChunkedFile, NoIndexError
from imucalib_cli.logs.db3.file import Db3File
from imucalib_cli.logs.mcap.file import McapFile
from imucalib_cli.logs.reader import HEAD
from imucalib_cli.logs.remote.file import RemoteFile, in_bytes
from imucalib_cli.logs.remote.store import NoRangesError
from imucalib_cli.logs.text.csv_file import CsvFile
from imucalib_cli.logs.text.tum_euroc import EurocTable, TumFile

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from imucalib_cli.logs.messages.table import Kind
    from imucalib_cli.logs.reader import LogFile, LogPath
    from imucalib_cli.logs.streams import Progress

    Readers = Sequence[type[LogFile]]


READERS: list[type[LogFile]] = [McapFile, BagFile, Db3File, EurocTable, CsvFile, TumFile]
"""Every format that can be read. A new format is one file in this package and one name here."""


def readers_with(csv_columns: Sequence[str]) -> Readers:
    """Every format, and tables without a header whose columns the user names, if any."""
    return [*READERS, CsvFile.with_columns(csv_columns)] if csv_columns else READERS


def check_csv_columns(files: Sequence[LogFile], readers: Readers) -> None:
    """Refuse a guess of a table's columns, if the user names columns and no table has those.

    Raises:
        InputError: A header of unknown names is taken for one of joints instead.
    """
    tables = [each for each in files if isinstance(each, CsvFile)]
    if any(each.IS_NAMED_BY_USER for each in tables):
        return
    for table in tables:
        if table.guessed:
            head = ",".join(table.guessed).encode()
            raise InputError(f"{table.path} {readers[-1].why_not(head, '')}")


_ZSTD = b"\x28\xb5\x2f\xfd"
_METADATA = b"rosbag2_bagfile_information"
_MARKS = (b"imucalib run --debug-mcap", b"time_s,stamp_ns,accel_x_measured_m_s2")
"""The library of our debugging MCAP, and the columns of our table: files beside a result, which
read as logs. One of these stands in their first _MARKED bytes."""
_MARKED = 128
_PART = re.compile(r"(.+)_(0|[1-9]\d*)((?:\.\w+)+)")
"""Name of a part of a split recording, as ``ros2 bag record`` numbers them from 0."""


def open_files(
    path: LogPath,
    readers: Readers = READERS,
    *,
    scan_remote: bool = False,
    progress: Progress = lambda _: None,
) -> list[LogFile]:
    """Open the files of a recording.

    Args:
        path: A file or folder, or a file behind a URL.
        readers: Formats that may be meant.
        scan_remote: Download a remote file that cannot be read in parts.
        progress: Called with the downloaded share, 0 to 1.

    Raises:
        InputError: Missing, unreadable, empty or not a log.
        ChoiceError: A folder without metadata.yaml holds several recordings, or a remote file
            would have to be read whole.
    """
    if isinstance(path, RemoteFile):
        return [_open_remote(path, readers, progress if scan_remote else None)]
    try:
        if stat.S_ISDIR(_mode(path)):
            return _open_folder(path, readers)
        head = _head(path)
        if path.suffix in {".yaml", ".yml"} and _METADATA in head:
            return _open_folder(path.parent, readers)
        return [_open_file(path, head, readers)]
    except FileNotFoundError as error:
        raise InputError(f"{path} {_why_missing(path)}") from error
    except OSError as error:
        reason = f"cannot be read: {error.strerror or error}"
        if isinstance(error, PermissionError):
            reason = "may not be read: check its permissions"
        raise InputError(f"{error.filename or path} {reason}") from error


def _mode(path: Path) -> int:
    """Check the kind of file before it is opened: opening a pipe would wait for its writer.

    Raises:
        InputError: It is neither a file nor a folder.
        OSError: It cannot be accessed; a link may lead nowhere, or in a circle.
    """
    mode = path.stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise InputError(
            f"{path} is a pipe or a device; reading a log needs random access: "
            "write it to a file first"
        )
    return mode


def _why_missing(path: Path) -> str:
    """The likely reason why a path does not exist."""
    if str(path) == "-":
        return "is no log: a log cannot be read from standard input: write it to a file first"
    broken = next((each for each in (path, *path.parents) if each.is_symlink()), None)
    if broken is not None and not broken.exists():
        return (
            f"leads nowhere: the link {broken} points to {broken.readlink()}, which does not exist"
        )
    return "does not exist: check the path"


def _head(path: Path) -> bytes:
    _mode(path)
    with path.open("rb") as file:
        return file.read(HEAD)


def _peek(path: Path) -> bytes:
    """Its first bytes; none if it cannot be read."""
    try:
        return _head(path)
    except (OSError, InputError):
        return b""


def _reader(path: Path, head: bytes, readers: Readers) -> type[LogFile] | None:
    return next((each for each in readers if each.matches(head, path)), None)


def holds_log(path: Path, *, alone: bool = False) -> bool:
    """Whether a file is a log, by its content; False if it cannot be read.

    ``alone``: of tables, only those that name columns of an IMU or of joints.
    """
    head = _peek(path)
    if head.startswith(_ZSTD) or _METADATA in head:
        return True
    reader = _reader(path, head, READERS)
    kinds = reader.named_kinds(head) if alone and reader is not None else None
    return reader is not None if kinds is None else bool(kinds - {"pose"})


def kinds_of_table(path: Path) -> set[Kind] | None:
    """Streams whose columns a table names; None of any other file, or if it cannot be read."""
    head = _peek(path)
    reader = _reader(path, head, READERS)
    return None if reader is None else reader.named_kinds(head)


def files_below(folder: Path) -> list[Path]:
    """Files of a folder's recording that lie deeper in it."""
    return [path for reader in READERS for path in reader.files_of(folder)]


def is_own_output(path: Path) -> bool:
    """Whether a file is one that imucalib writes beside a result; False if it cannot be read."""
    head = _peek(path)[:_MARKED]
    return any(mark in head for mark in _MARKS)


def _open_file(path: Path, head: bytes, readers: Readers) -> LogFile:
    if head.startswith(_ZSTD):
        from imucalib_cli.logs.unpacked import cut_table, unpack

        unpacked, loss = unpack(path)
        head = _head(unpacked)
        kind = _reader(unpacked, head, readers)
        if kind is not None and kind.IS_TEXT:
            loss = cut_table(unpacked, path.stat().st_size) or loss
        if head.startswith(_ZSTD):
            raise InputError(f"{path} is compressed twice: unpack it with zstd -d")
        if kind is None:
            cut = "" if loss is None else ", as far as it could be unpacked"
            raise InputError(f"{path} does not unpack to a log{cut}: expected {_known(readers)}")
        file = _open_copy(path, unpacked, readers)
        if loss is not None:
            file.losses.append(loss)
        return file
    reader = _reader(path, head, readers)
    if reader is None:
        raise _no_log(path, head, readers)
    return reader(path)


def _open_copy(path: LogPath, copied: Path, readers: Readers) -> LogFile:
    """Open a temporary file, which the user does not know, under the name of its origin."""
    try:
        file = _open_file(copied, _head(copied), readers)
    except InputError as error:
        raise InputError(str(error).replace(str(copied), str(path))) from error
    file.path = path
    return file


def _open_remote(remote: RemoteFile, readers: Readers, progress: Progress | None) -> LogFile:
    """Open a file behind a URL in parts; whole only if there is a ``progress`` to tell of it."""
    if remote.is_folder:
        raise InputError(f"{remote} is a folder: name its .mcap or .bag files one by one")
    try:
        head = remote.head(HEAD)
        reader = _reader(Path(remote.name), head, readers)
        if head.startswith(_ZSTD):
            reason = "it is compressed as a whole"
        elif _METADATA in head:
            raise InputError(f"{remote} only lists files: name those one by one")
        elif reader is None:
            raise _no_log(remote, head, readers)
        elif issubclass(reader, ChunkedFile):
            try:
                return reader(remote)
            except NoIndexError:
                reason = "it has no usable index, perhaps because the recorder was killed"
        else:
            reason = f"{reader.FORMAT} has no index"
    except NoRangesError:
        reason = "its server does not send parts of a file"
    if progress is None:
        size = "" if remote.size is None else f", {in_bytes(remote.size)}"
        raise ChoiceError(
            f"{remote} would have to be read whole{size}: {reason}; download it, or "
            "make a temporary copy with --allow-remote-scan",
            option="--allow-remote-scan",
        )
    return _open_copy(remote, remote.download(progress), readers)


def _no_log(path: LogPath, head: bytes, readers: Readers) -> InputError:
    if not head:
        return InputError(f"{path} is empty: record or copy it again")
    # the last one is what the user asks for
    reasons = filter(None, (each.why_not(head, path.name) for each in reversed(readers)))
    return InputError(f"{path} {next(reasons, f'is not a log: expected {_known(readers)}')}")


def _known(readers: Readers) -> str:
    *names, last = dict.fromkeys(each.FORMAT for each in readers)
    return f"{', '.join(names)} or {last}, or a folder of them"


def _open_folder(folder: Path, readers: Readers) -> list[LogFile]:
    named = _listed(folder)
    missing = [each for each in named if not each.is_file()]
    found = _guessed(folder, readers) if len(missing) == len(named) else named
    if not found:
        raise InputError(f"{folder} holds no log: expected {_known(readers)}")
    files: list[LogFile] = []
    losses = [warning("log.part_missing", name=each.name) for each in missing]
    unusable: list[InputError] = []
    for path in (each for each in found if each not in missing):
        try:
            files.append(_open_file(path, _head(path), readers))
        except InputError as error:  # a last part that a crash truncated costs only that part
            unusable.append(error)
            losses.append(warning("log.part_unusable", reason=str(error)))
    if not files:
        raise unusable[0]
    files[0].losses.extend(losses)
    return files


def _listed(folder: Path) -> list[Path]:
    """Files named by metadata.yaml; none if it is missing or damaged."""
    metadata = folder / "metadata.yaml"
    if not metadata.is_file():
        return []
    from imucalib_cli.guarded_yaml import load_one, read_bounded

    try:
        with metadata.open("rb") as file:
            content = load_one(read_bounded(file, "replace"))
        names = content["rosbag2_bagfile_information"]["relative_file_paths"]
        if not isinstance(names, list):
            return []
        # Early rosbag2 versions wrote the folder's name in front.
        named = dict.fromkeys(Path(name).name for name in names)
    except (KeyError, TypeError, ValueError):
        return []
    return [folder / name for name in named if name]


def _guessed(folder: Path, readers: Readers) -> list[Path]:
    """Log files of a folder without metadata.yaml: one recording, if their names show it."""
    logs = []
    below = ((each, path) for each in readers for path in each.files_of(folder))
    tables = [path for each, path in below if each.matches(_head(path), path)]
    for path in sorted(each for each in folder.iterdir() if each.is_file()):
        head = _head(path)
        reader = None if is_own_output(path) else _reader(path, head, readers)
        if head.startswith(_ZSTD) or (reader is not None and not reader.IS_TEXT):
            logs.append(path)
        elif reader is not None:
            tables.append(path)
    if not logs:
        return tables  # tables: one for each sensor, of any name
    first, *others = recordings_of(logs)
    if others:
        names = ", ".join(each.name for each in logs)
        raise ChoiceError(f"{folder} holds several recordings, name one of them: {names}")
    return list(first)


def recordings_of(paths: Iterable[Path]) -> Iterator[tuple[Path, ...]]:
    """Files of one folder, with the parts of a split recording (NAME_0, NAME_1, ...) together."""
    parts: dict[object, dict[int, Path]] = {}
    for path in paths:
        match = _PART.fullmatch(path.name)
        group, number = ((match[1], match[3]), int(match[2])) if match else (path, 0)
        parts.setdefault(group, {})[number] = path
    for numbered in parts.values():
        if sorted(numbered) == list(range(len(numbered))):
            yield tuple(numbered[number] for number in sorted(numbered))
        else:
            yield from ((path,) for path in numbered.values())
