"""Files that rosbag2 compressed as a whole: unpacked beside the system's temporary files."""

from __future__ import annotations

import atexit
import os
import tempfile
from pathlib import Path

from imucalib_cli.errors import InputError

_STEP = 1 << 20


def unpack(path: Path) -> tuple[Path, str]:
    """Unpack a zstd file into a temporary one, which is removed when the process ends.

    Returns:
        The temporary file, and a sentence on what was lost or an empty one.

    Raises:
        InputError: Nothing of it can be unpacked, or the disk is full.
    """
    import zstandard

    handle, name = tempfile.mkstemp(prefix="imucalib-", suffix=path.with_suffix("").suffix)
    target = Path(name)
    atexit.register(target.unlink, missing_ok=True)
    loss = ""
    with os.fdopen(handle, "wb") as out, path.open("rb") as packed:
        reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
        try:
            while data := reader.read(_STEP):
                out.write(data)
        except zstandard.ZstdError as error:
            loss = f"its compression is damaged ({error}): what stands before is used"
        except OSError as error:
            raise InputError(
                f"{path} cannot be unpacked into {target.parent}: {error}; free some space there "
                "or set TMPDIR"
            ) from error
        if not out.tell():
            raise InputError(f"{path} cannot be unpacked: record or copy it again")
    return target, loss
