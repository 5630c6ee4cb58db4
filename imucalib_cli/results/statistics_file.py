"""The file of a log's statistics: a NumPy archive (.npz), solved again without the log.

It contains its result too. Layout: docs/several-logs.md.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
from typing import TYPE_CHECKING, Any, Final

import msgspec
import numpy as np
from msgspec import Struct

from imucalib_cli import __version__
from imucalib_cli.errors import ImucalibError, InputError
from imucalib_cli.estimate.checks.segments import FOLDS
from imucalib_cli.estimate.effects import JointCurve, Mount, Origin
from imucalib_cli.estimate.model.layout import Joint, Placed, with_priors
from imucalib_cli.estimate.model.state import State
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.estimate.solution.normal_equations import (
    LogStatistics,
    NormalEquations,
    WindowAnswer,
)
from imucalib_cli.estimate.solution.spectrum import Spectrum
from imucalib_cli.estimate.unknowns import unknown_named
from imucalib_cli.results.codec import result_from

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from imucalib_cli.arrays import Floats
    from imucalib_cli.results.result import Result

_WHAT: Final = "statistics of an imucalib result"
_SCHEMA: Final = 2
_ROOM: Final = 1_100_000
"""Bytes for all matrices; parts are joined until they fit. Compressed they take a tenth less."""
_LARGEST: Final = 64 << 20
"""Bytes of all arrays of a file: fifty times the largest that is written."""
_ROUNDING: Final = 1e-6
"""Of the determinant of a rotation: far more than that of doubles."""
_NUMBERS: Final[dict[str, Callable[[Any], Any]]] = {
    "seconds": float,
    "clock_stepped": bool,
    "offset_variance": float,
}
"""Numbers of the statistics in the header, and their types."""
_SYMMETRIC: Final = ("information", "noise", "motion")


class StoredLog(Struct, frozen=True, kw_only=True, eq=False):
    """A result and the statistics from which it was solved."""

    name: str
    """Of the file."""
    result: Result
    statistics: LogStatistics


def place_of(result: Path) -> Path:
    """The file for the statistics of a result, beside the result."""
    return result.with_name(f"{result.stem}.statistics.npz")


def statistics_bytes(result: Result, statistics: LogStatistics) -> bytes:
    """The file for one IMU; the same statistics give the same bytes."""
    equations, layout = statistics.equations, statistics.equations.layout
    origins = [each for each, _ in layout.of(Origin)]
    header = {
        "what": _WHAT,
        "schema": _SCHEMA,
        "version": __version__,
        "result": msgspec.to_builtins(result),
        "options": msgspec.to_builtins(statistics.options, enc_hook=lambda each: each.tolist()),
        "unknowns": [
            {"name": each.unknown.name}
            | {key: getattr(each, key) for key in ("labels", "unit", "hidden")}
            for each in layout.placed
        ],
        "still": layout.still,
        "held_offset": equations.at.held_offset,
        "level": equations.level,
        **{name: getattr(statistics, name) for name in _NUMBERS},
    }
    arrays: dict[str, Any] = {
        **{name: getattr(equations.at, name) for name in ("R", "t", "gravity", "x")},
        "score": equations.score,
        **{name: _packed(getattr(equations, name)) for name in _SYMMETRIC},
        "directions": np.concatenate([np.zeros((0, 3)), *(each.directions for each in origins)]),
        "turns": np.reshape([each.R_joint for each in origins], (-1, 3, 3)),
        "widened": statistics.widened,
        "window_seconds": np.array([each.seconds for each in statistics.windows]),
        "window_changes": np.array([each.changes for each in statistics.windows]).reshape(
            -1, layout.size
        ),
        **_joined(statistics.parts, statistics.edges),
    }
    for sensor, spectrum in zip(("accel", "gyro"), statistics.spectra, strict=True):
        arrays[f"{sensor}_frequency"] = spectrum.frequency
        arrays[f"{sensor}_density"] = spectrum.density
        arrays[f"{sensor}_own_density"] = np.array(spectrum.own)
    text = np.frombuffer(json.dumps(header, ensure_ascii=False).encode(), dtype=np.uint8)
    file = io.BytesIO()
    np.savez_compressed(file, header=text, **arrays)
    return file.getvalue()


def read_statistics(path: Path) -> StoredLog:
    """The statistics of one IMU; InputError for another or a damaged file."""
    try:
        return _read(path)
    except (ImucalibError, MemoryError):
        raise
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}): check the path") from error
    except Exception as error:  # another or a damaged archive may raise anything
        raise InputError(
            f"{path}: is damaged or has no {_WHAT}: write it again by `imucalib run --statistics`"
        ) from error


def _read(path: Path) -> StoredLog:
    with zipfile.ZipFile(path) as archive:
        if sum(each.file_size for each in archive.infolist()) > _LARGEST:
            raise InputError(f"{path}: is too large to be a file with {_WHAT}")
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: np.asarray(file[name]) for name in file.files}
    header = json.loads(arrays.pop("header").tobytes())
    if header.get("what") != _WHAT:
        raise InputError(f"{path}: has no {_WHAT}: write them by `imucalib run --statistics`")
    if header["schema"] != _SCHEMA:
        raise InputError(
            f"{path}: is of schema {header['schema']}, this version reads {_SCHEMA}: use the "
            "imucalib it came from"
        )
    result = result_from(header["result"], str(path))
    return StoredLog(name=str(path), result=result, statistics=_statistics(header, arrays))


def _statistics(header: dict[str, Any], arrays: dict[str, Floats]) -> LogStatistics:
    if not all(np.isfinite(each).all() for each in arrays.values()):
        raise ValueError("numbers that are not finite")
    level, R = float(header["level"]), arrays["R"].reshape(3, 3)
    if not 0.0 < level < math.inf:
        raise ValueError("a level of noise that is not positive")
    if abs(np.linalg.det(R) - 1.0) > _ROUNDING:
        raise ValueError("a matrix that is not a rotation")
    options = msgspec.convert(
        header["options"], MatchedOptions, dec_hook=lambda _, numbers: np.array(numbers)
    )
    origins, turns = iter(arrays["directions"]), iter(arrays["turns"])
    placed = [_placed(each, origins, turns) for each in header["unknowns"]]
    layout = with_priors(placed, options, tuple(header["still"]))
    n = layout.size
    at = State(
        R=R,
        t=arrays["t"].reshape(3),
        gravity=arrays["gravity"].reshape(3),
        x=arrays["x"].reshape(n),
        held_offset=float(header["held_offset"]),
    )
    return LogStatistics(
        equations=NormalEquations(
            layout=layout,
            at=at,
            score=arrays["score"].reshape(n),
            level=level,
            **{name: _unpacked(arrays[name], n) for name in _SYMMETRIC},
        ),
        options=options,
        parts=_unpacked(arrays["blocks"], n + 1),
        edges=arrays["edges"],
        spectra=(_spectrum("accel", arrays), _spectrum("gyro", arrays)),
        windows=tuple(
            WindowAnswer(seconds=float(seconds), changes=changes.reshape(n))
            for seconds, changes in zip(
                arrays["window_seconds"], arrays["window_changes"], strict=True
            )
        ),
        widened=arrays["widened"].reshape(6, 6),
        **{name: kind(header[name]) for name, kind in _NUMBERS.items()},
    )


def _placed(entry: dict[str, Any], origins: Any, turns: Any) -> Placed:
    unknown, labels = unknown_named(entry["name"]), tuple(map(str, entry["labels"]))
    joint = None
    if isinstance(unknown.effect, JointCurve):
        slides = entry["unit"] != unknown.unit
        # The name of a joint may have spaces, too.
        name = labels[0].removesuffix(unknown.labels[0]).strip()
        joint = Joint(name, -1, -1, (), slides)
    is_origin = isinstance(unknown.effect, Origin)
    if isinstance(unknown.effect, Mount) and len(labels) != 3:
        raise ValueError("a mount of other than three components")
    return Placed(
        unknown,
        slice(0, 0),
        labels,
        joint=joint,
        directions=np.array([next(origins) for _ in labels]) if is_origin else np.eye(3),
        R_joint=next(turns).reshape(3, 3) if is_origin else np.eye(3),
        hidden=bool(entry["hidden"]),
    )


def _spectrum(sensor: str, arrays: dict[str, Floats]) -> Spectrum:
    return Spectrum(
        frequency=arrays[f"{sensor}_frequency"],
        density=arrays[f"{sensor}_density"],
        own=float(arrays[f"{sensor}_own_density"]),
    )


def _joined(parts: Floats, edges: Floats) -> dict[str, Floats]:
    """The parts joined to as many longer parts of equal duration as there is room for."""
    size = 8 * parts.shape[1] * (parts.shape[1] + 1) // 2
    most = min(max(_ROOM // size - len(_SYMMETRIC), 1), FOLDS, len(parts))
    count = max(each for each in range(1, most + 1) if len(parts) % each == 0)
    joined = parts.reshape(count, -1, *parts.shape[1:]).sum(axis=1)
    return {"blocks": _packed(joined), "edges": edges[:: len(parts) // count]}


def _packed(matrix: Floats) -> Floats:
    """(..., n (n + 1) / 2), the upper triangle of symmetric matrices, row by row."""
    rows, columns = np.triu_indices(matrix.shape[-1])
    return np.asarray(matrix[..., rows, columns])


def _unpacked(packed: Floats, n: int) -> Floats:
    """(..., n, n), symmetric."""
    rows, columns = np.triu_indices(n)
    if packed.shape[-1] != len(rows):
        raise ValueError(f"{packed.shape[-1]} numbers of a matrix of {n} rows")
    matrix = np.zeros((*packed.shape[:-1], n, n))
    matrix[..., rows, columns] = packed
    matrix[..., columns, rows] = packed
    return matrix
